// The timeline: sentences one after another as blocks to select, drag, stretch, cut and reorder; the time that is seen.
import { element } from "./elements.js";
import { cutAt, edges, isSequence, MOST_SEGMENTS, moved, removed, rounded, segmentAt, withSegment } from "./project.js";

const NUDGE = 0.1; // seconds per key
const DRAG = 5; // pixels before a press is a drag
const TICKS = [0.5, 1, 2, 5, 10, 20]; // seconds between the marks of the ruler
const CLOSE = 56; // pixels between two of them, at least

/**
 * @param limits [shortest, longest] seconds of a segment
 * @param on {read() -> project with what the form says, select(at), change(project, selected), add(), seek(seconds)}
 */
export function createTimeline(box, limits, on) {
  const [lane, ruler, head, tracks] = [".segments", ".ruler", ".playhead", ".tracks"].map((name) => box.querySelector(name));
  const [add, cut, drop] = [".add-segment", ".cut", ".drop"].map((name) => box.querySelector(name));
  let project = null;
  let selected = 0;
  let length = 0; // seconds of the clip that is seen
  let time = 0;
  let fresh = null; // segments that were made anew, the others being as they were

  const lengths = () => project.segments.map(({ seconds }) => Number(seconds ?? length));
  const whole = () => (isSequence(project) ? edges(project).at(-1) : length) || 1;
  const share = (seconds) => `${(100 * seconds) / whole()}%`;
  const bounded = (seconds) => rounded(Math.min(Math.max(seconds, limits[0]), limits[1]));

  function block(segment, at) {
    const seconds = lengths()[at];
    const say = `Segment ${at + 1} of ${project.segments.length}: ${segment.text}, ${seconds.toFixed(1)} s`;
    const button = element(
      "button",
      { type: "button", class: `segment${fresh?.includes(at) ? " fresh" : ""}`, "aria-label": say, title: segment.text, "aria-pressed": String(at === selected) },
      element("span", {}, segment.text.replace(/^an? person /, "")),
      element("small", {}, `${seconds.toFixed(1)} s`),
    );
    const edge = element("span", { class: "edge", title: "Drag to lengthen" });
    const item = element("li", { "data-at": at }, button, edge);
    item.style.setProperty("--share", seconds);
    button.addEventListener("click", () => on.select(at));
    button.addEventListener("keydown", (event) => pressed(event, at));
    button.addEventListener("pointerdown", (event) => reorder(event, item, at));
    edge.addEventListener("pointerdown", (event) => stretch(event, item, at, seconds));
    return item;
  }

  function draw() {
    const focused = lane.contains(document.activeElement);
    lane.replaceChildren(...project.segments.map(block));
    if (focused) lane.children[selected]?.firstChild.focus();
    add.disabled = project.segments.length >= MOST_SEGMENTS;
    drop.disabled = project.segments.length < 2;
    box.hidden = !length;
    for (const name of [".segment-tools", ".segments", ".layers", ".add-layer"]) box.querySelector(name).hidden = Boolean(project.concepts);
    marks();
    move();
  }

  function marks() {
    const width = lane.clientWidth || 600;
    const step = TICKS.find((tick) => (tick / whole()) * width >= CLOSE) ?? TICKS.at(-1);
    const ticks = Array.from({ length: Math.floor(whole() / step) + 1 }, (_, k) => k * step);
    ruler.replaceChildren(
      ...ticks.map((tick) => {
        const mark = element("span", {}, `${tick} s`);
        mark.style.left = share(tick);
        return mark;
      }),
    );
  }

  /** Time of the timeline at the time of the clip: joins may make a clip a little longer or shorter than its parts. */
  const placed = (seconds) => (length ? (seconds * whole()) / length : 0);

  function move() {
    head.style.left = share(Math.min(placed(time), whole()));
  }

  // -- pointer ------------------------------------------------------------------------------------------------------

  /** Follow a press until it ends; `ended(moved)` gets the pixels, or null where it was hardly a drag. */
  function follow(event, during, ended) {
    if (event.button) return;
    const target = event.currentTarget;
    const start = event.clientX;
    let far = 0;
    target.setPointerCapture(event.pointerId);
    const onmove = (now) => {
      far = Math.abs(now.clientX - start) > DRAG || far ? now.clientX - start : 0;
      if (far) during(far);
    };
    const onend = (now) => {
      target.removeEventListener("pointermove", onmove);
      for (const kind of ["pointerup", "pointercancel"]) target.removeEventListener(kind, onend);
      ended(now.type === "pointerup" && far ? far : null);
    };
    target.addEventListener("pointermove", onmove);
    for (const kind of ["pointerup", "pointercancel"]) target.addEventListener(kind, onend);
  }

  const perPixel = () => whole() / (lane.clientWidth || 1);

  function stretch(event, item, at, seconds) {
    const scale = perPixel(); // as it was: the lane grows with the segment
    const longer = (far) => bounded(seconds + far * scale);
    event.preventDefault();
    follow(
      event,
      (far) => {
        item.style.setProperty("--share", longer(far));
        item.querySelector("small").textContent = `${longer(far).toFixed(1)} s`;
      },
      (far) => (far === null ? draw() : resize(at, longer(far))),
    );
  }

  function reorder(event, item, at) {
    const centres = [...lane.children].map((other) => other.offsetLeft + other.offsetWidth / 2);
    const target = (far) => centres.filter((centre, k) => k !== at && centre < centres[at] + far).length;
    follow(
      event,
      (far) => {
        item.classList.add("dragged");
        item.style.transform = `translateX(${far}px)`;
        [...lane.children].forEach((other, k) => other.classList.toggle("before", k !== at && k === target(far) + (target(far) >= at ? 1 : 0)));
      },
      (far) => {
        if (far !== null && target(far) !== at) on.change(moved(timed(), at, target(far)), target(far));
        else if (item.style.transform) draw(); // a mere press goes on to be a click on this very block
      },
    );
  }

  // -- what buttons and keys do -------------------------------------------------------------------------------------

  /** The project as it stands in the form, every length as it is seen: with a second segment, each has its own. */
  function timed() {
    project = on.read();
    return project.segments.reduce((found, _, at) => withSegment(found, at, { seconds: bounded(lengths()[at]) }), project);
  }

  const resize = (at, seconds) => on.change(withSegment(timed(), at, { seconds: bounded(seconds) }), at);

  function splitHere() {
    const known = timed();
    const next = cutAt(known, placed(time), limits[0]);
    if (next !== known) on.change(next, segmentAt(known, placed(time)).at + 1);
  }

  function remove(at) {
    if (project.segments.length > 1) on.change(removed(timed(), at), Math.max(at - 1, 0));
  }

  function pressed(event, at) {
    const { key, altKey, shiftKey } = event;
    const by = { ArrowLeft: -1, ArrowRight: 1 }[key] ?? 0;
    const to = at + by;
    if (by && shiftKey) resize(at, lengths()[at] + by * NUDGE);
    else if (by && altKey && project.segments[to]) on.change(moved(timed(), at, to), to);
    else if (by && !altKey && project.segments[to]) {
      on.select(to);
      lane.children[to].firstChild.focus();
    } else if (key === "Delete" || key === "Backspace") remove(at);
    else if (!by) return;
    event.preventDefault();
  }

  add.addEventListener("click", on.add);
  cut.addEventListener("click", splitHere);
  drop.addEventListener("click", () => remove(selected));
  ruler.addEventListener("pointerdown", (event) => {
    const seek = (x) => {
      const { left, width } = ruler.getBoundingClientRect();
      on.seek((Math.min(Math.max((x - left) / width, 0), 1) * whole() * length) / whole());
    };
    const start = event.clientX;
    seek(start);
    follow(event, (far) => seek(start + far), () => {});
  });
  new ResizeObserver(() => project && marks()).observe(lane);

  return {
    tracks,
    share,
    timed,
    split: splitHere,
    /** Seconds of the project at the time that is seen. */
    get now() {
      return rounded(placed(time));
    },
    get whole() {
      return whole();
    },
    /** made: segments that were made anew, where others were not. */
    show(shown, which, seconds, made = null) {
      [project, selected, length] = [shown, which, seconds];
      fresh = made && made.length < shown.segments.length ? made : null;
      draw();
    },
    at(seconds) {
      time = seconds;
      if (project) move();
    },
  };
}
