// One page for both: clips that are in it (kinegraph view), or a form that asks the server for them (kinegraph play).
import { loadActor } from "./actor.js";
import { describeClips } from "./describe.js";
import { openPlayground } from "./playground.js";
import { createStage } from "./stage.js";
import { createTransport } from "./transport.js";

async function start() {
  const data = JSON.parse(document.getElementById("data").textContent);
  const side = document.querySelector(".side");
  const stage = createStage(document.querySelector(".view"));
  const clock = new EventTarget(); // tells every time that is shown, as an event "time"
  const ontime = (seconds) => clock.dispatchEvent(new CustomEvent("time", { detail: seconds }));
  const transport = createTransport(document.querySelector(".transport"), stage, ontime);
  if (data.play) await openPlayground(side, data.play, stage, transport, clock);
  else {
    describeClips(side, data.clips);
    stage.show(await Promise.all(data.clips.map((clip) => loadActor(clip))));
    transport.restart();
  }
  document.documentElement.dataset.ready = "";
}

start().catch((error) => {
  document.querySelector(".status span").textContent = `This page cannot show the motion: ${error.message}`;
});
