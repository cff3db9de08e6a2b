// Play, pause, scrub, speed; the keyboard for all of them. Nothing is drawn while nothing moves.
const HOLD = 0.5; // seconds that the last pose stays before the clip begins again

/** ontime(seconds) is told every time that is shown. */
export function createTransport(box, stage, ontime = () => {}) {
  const [play, scrub, clock, speed, camera] = [".play", ".scrub", ".clock", ".speed", ".camera"].map((name) =>
    box.querySelector(name),
  );
  let time = 0;
  let playing = false;
  let last = 0;

  function place(seconds) {
    time = seconds;
    const shown = Math.min(Math.max(time, 0), stage.duration);
    scrub.max = stage.duration;
    scrub.step = stage.frame;
    scrub.value = shown;
    const whole = stage.duration && stage.duration + stage.frame; // the last frame lasts, too
    const words = `${(shown < stage.duration ? shown : whole).toFixed(1)} / ${whole.toFixed(1)} s`;
    clock.textContent = words;
    scrub.setAttribute("aria-valuetext", words);
    stage.at(shown);
    ontime(shown);
  }

  function tick(now) {
    if (!playing) return;
    const rate = Number(speed.value);
    const next = time + ((now - last) / 1000) * rate;
    last = now;
    if (stage.loops) place(next % stage.duration); // the last frame is the first again
    else place(next > stage.duration + HOLD * rate ? 0 : next);
    requestAnimationFrame(tick);
  }

  function setPlaying(wanted) {
    if (wanted && time >= stage.duration) time = 0;
    const begins = wanted && !playing;
    playing = wanted && stage.duration > 0;
    play.setAttribute("aria-label", playing ? "Pause" : "Play");
    play.classList.toggle("on", playing);
    if (begins && playing) {
      last = performance.now();
      requestAnimationFrame(tick);
    }
  }

  function step(frames) {
    setPlaying(false);
    place(Math.min(Math.max(Math.min(time, stage.duration) + frames * stage.frame, 0), stage.duration));
  }

  play.addEventListener("click", () => setPlaying(!playing));
  camera.addEventListener("click", stage.recentre);
  scrub.addEventListener("input", () => {
    setPlaying(false);
    place(Number(scrub.value));
  });
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.closest("textarea, select, button, summary, input:not([type=range])")) return;
    const act = { " ": () => setPlaying(!playing), ",": () => step(-1), ".": () => step(1), 0: stage.recentre }[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });
  place(0);

  return {
    get playing() {
      return playing;
    },
    /** From the beginning; at once, unless the reader asked for less motion. */
    restart() {
      place(0);
      setPlaying(!matchMedia("(prefers-reduced-motion: reduce)").matches);
    },
    /** Stop at a time. */
    seek(seconds) {
      setPlaying(false);
      place(Math.min(Math.max(seconds, 0), stage.duration));
    },
    /** The clips have changed under a clip that plays on. */
    refresh() {
      place(Math.min(time, stage.duration));
      setPlaying(playing);
    },
  };
}
