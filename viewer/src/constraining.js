// Constraints of the project: pins on the timeline and balls in the room are two views of the same; what adds one.
import { drawnPath, hasFree, middle, MOST, place, POSE_FRAMES } from "./constraints.js";
import { element } from "./elements.js";
import { createFloor } from "./floor.js";
import { createPins } from "./pins.js";

const PINS = { "left hand": "left_wrist", "right hand": "right_wrist", "left foot": "left_foot", "right foot": "right_foot", head: "head" };
const STEPS = 9; // points that are looked at of the way that is gone now

/**
 * @param box the timeline
 * @param facts of the bundle: {constrained, joints}
 * @param on {project(), clip(), body() -> actor of our own body, time() in the clip, now() and whole() of the timeline,
 *   seek(seconds) and stop there, selected() one of them, change(constraints, done), colour(name), say(words)}
 */
export function createConstraining(box, view, stage, facts, on) {
  const pins = createPins(box, { select, change: (constraints) => on.change(constraints, true) });
  const room = createFloor(view, stage, { change: dragged, drawn, colour: on.colour, held: () => on.seek(on.time()) });
  const kinds = box.querySelector(".pin-kinds");
  const menu = box.querySelector(".pin-menu");
  const [path, waypoint] = [".add-path", ".add-waypoint"].map((name) => box.querySelector(name));
  const all = () => on.project().constraints;
  let selected = -1;
  let seen = 0; // time that was seen before a path is drawn
  box.querySelector(".constrain").hidden = !facts.constrained;

  function select(at) {
    selected = pins.select(at);
    room.show(all(), selected);
    if (selected >= 0) on.selected();
  }

  /** Whether the clip that is seen is the one that constraints are for: they hold before it is looped or put in place. */
  function isPlain() {
    const { loop, in_place: inPlace } = on.project().shape;
    if (loop || inPlace) on.say("Switch Loop and In place off first: pins belong to the clip before that");
    return !loop && !inPlace;
  }

  function add(constraint) {
    if (all().length >= MOST) return;
    on.change([...all(), constraint], true);
    select(all().length - 1);
  }

  function dragged(at, constraint, done) {
    on.change(all().with(at, constraint), done);
  }

  /** A path that was drawn; without one, a second press of the button takes the way that is gone now. */
  function drawn(line) {
    on.say("");
    on.seek(seen);
    if (line) add(line);
  }

  async function wayNow() {
    const { path: way } = await on.body();
    const points = Array.from({ length: STEPS }, (_, k) => way[Math.round((k * (way.length - 1)) / (STEPS - 1))]);
    drawn(drawnPath(points.map(({ x, z }) => [x, z])));
  }

  /** Pins with free axes stand where their joints are in the clip that is seen. */
  async function freePlaces() {
    const shown = all();
    const body = await on.body();
    const at = on.time();
    const found = shown.map((one) => (hasFree(one) ? body.joints([one.joint], middle(one, on.whole()))[0] : null));
    body.pose(at);
    if (shown === all()) room.show(shown, selected, found.map((place) => place ?? undefined));
  }

  async function joints(names, time) {
    return (await on.body()).joints(names, time);
  }

  async function addWaypoint() {
    if (!isPlain()) return;
    const [[x, , z]] = await joints(["pelvis"], on.time());
    add({ type: "waypoint", seconds: on.now(), position: place([x, z]) });
  }

  async function pinJoint(joint) {
    if (!isPlain()) return;
    const [position] = await joints([joint], on.time());
    add({ type: "joint", joint, position: place(position), seconds: on.now() });
  }

  const pose = async (time) => (await joints(facts.joints, time)).map(place);

  async function pinPose() {
    if (!isPlain()) return;
    add({ type: "keyframe", seconds: on.now(), joints: await pose(on.time()) });
  }

  /** The pose that is seen now, with its velocity, as the first or last of the clip. */
  async function pinEnd(type) {
    if (!isPlain()) return;
    const { fps, frames } = on.clip();
    const first = Math.min(Math.round(on.time() * fps), Math.max(frames - POSE_FRAMES, 0));
    const poses = [];
    for (let k = 0; k < POSE_FRAMES; k++) poses.push(await pose((first + k) / fps));
    const others = all().filter((constraint) => constraint.type !== type);
    on.change([...others, { type, joints: poses, fps }], true);
    select(all().length - 1);
  }

  function pencil() {
    if (!isPlain()) return null;
    if (room.drawing) {
      room.pencil(false);
      return wayNow();
    }
    seen = on.time();
    on.seek(0); // a clip begins at the origin, and so does its path
    room.pencil(true);
    return on.say("Draw the way on the floor; press Path again for the way it goes now");
  }

  const choice = (name, act) =>
    element("button", { type: "button", onclick: () => {
      menu.open = false;
      act();
    } }, name);
  kinds.append(
    ...Object.entries(PINS).map(([name, joint]) => choice(name, () => pinJoint(joint))),
    choice("this pose", pinPose),
    choice("begin in this pose", () => pinEnd("start")),
    choice("end in this pose", () => pinEnd("end")),
  );
  menu.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    menu.open = false;
    menu.querySelector("summary").focus();
  });
  document.addEventListener("click", (event) => menu.contains(event.target) || (menu.open = false));
  path.addEventListener("click", pencil);
  waypoint.addEventListener("click", addWaypoint);

  return {
    /** misses: of the clip that is seen, one for each constraint. */
    show(misses) {
      pins.show(all(), on.whole(), misses);
      room.show(all(), selected < all().length ? selected : (selected = -1));
      if (all().some(hasFree)) freePlaces();
    },
    deselect: () => selected >= 0 && select(-1),
    path: () => facts.constrained && pencil(),
    waypoint: () => facts.constrained && addWaypoint(),
    /** Give up drawing; false if nothing was being drawn. */
    cancel() {
      if (!room.drawing) return false;
      room.pencil(false);
      on.seek(seen);
      on.say("");
      return true;
    },
  };
}
