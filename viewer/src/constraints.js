// Constraints as the request has them (kinegraph.formats.constraints_json): where the root, a joint or the whole body is, and when. Plain
// values, nothing drawn. Metres, +Y up; a clip begins at the origin and faces +Z. Places on the floor are [x, z].
export const MOST = 32; // constraints of one project
export const MOST_POINTS = 16; // of a path that was drawn
export const POSE_FRAMES = 4; // of a first or last pose
const NEAR = 0.1; // metres from the origin at which a path may begin
const SLACK = 0.04; // metres by which a drawn path may be straightened
const MILLIMETRES = 1000;

export const millimetres = (value) => Math.round(value * MILLIMETRES) / MILLIMETRES;
export const place = (point) => point.map((value) => (value === null ? null : millimetres(value)));

/** What a pin is called. */
export function nameOf({ type, joint }) {
  return { path: "path", waypoint: "waypoint", joint: joint?.replace("wrist", "hand").replace("_", " "), keyframe: "pose", start: "first pose", end: "last pose", loop: "loop" }[type];
}

/** Begin and end on a timeline of so many seconds. */
export function span(constraint, whole) {
  const { type, seconds, times } = constraint;
  if (type === "path") return times ? [times[0], times.at(-1)] : [0, whole];
  if (type === "start") return [0, 0];
  if (type === "end") return [whole, whole];
  if (type === "loop") return [0, whole];
  return [].concat(seconds).length === 2 ? seconds : [seconds, seconds];
}

/** Whether the time of a constraint is its own. */
export const isTimed = ({ type, times }) => ["waypoint", "joint", "keyframe"].includes(type) || (type === "path" && Boolean(times));

/** The constraint later by some seconds, inside the timeline. */
export function shifted(constraint, by, whole) {
  if (!isTimed(constraint)) return constraint;
  const [begin, end] = span(constraint, whole);
  const shift = Math.min(Math.max(by, -begin), whole - end);
  const later = (seconds) => Math.round((seconds + shift) * 100) / 100;
  if (constraint.type === "path") return { ...constraint, times: constraint.times.map(later) };
  return { ...constraint, seconds: Array.isArray(constraint.seconds) ? constraint.seconds.map(later) : later(constraint.seconds) };
}

/** The constraint moved by metres [x, y, z]; what has no height keeps it. */
export function translated(constraint, [x, y, z]) {
  const { type } = constraint;
  if (type === "path") return { ...constraint, points: constraint.points.map(([a, b]) => place([a + x, b + z])) };
  if (type === "waypoint") return { ...constraint, position: place([constraint.position[0] + x, constraint.position[1] + z]) };
  if (type !== "joint") return constraint;
  const [a, b, c] = constraint.position;
  return { ...constraint, position: place([a === null ? a : a + x, b === null ? b : Math.max(b + y, 0), c === null ? c : c + z]) };
}

/**
 * Points of a constraint that can be taken hold of: [x, y, z] each.
 * @param seen where the joint of a clip is at that time: there a pin stands along axes that are free
 */
export function handles({ type, points, position }, seen = [0, 0, 0]) {
  if (type === "path") return points.map(([x, z]) => [x, 0, z]);
  if (type === "waypoint") return [[position[0], 0, position[1]]];
  return type === "joint" ? [position.map((value, axis) => value ?? seen[axis])] : [];
}

/** Whether a pin leaves an axis free. */
export const hasFree = ({ type, position }) => type === "joint" && position.includes(null);

/** The pin with an axis left free; the last one stays. */
export function freed(constraint, axis) {
  const position = constraint.position.with(axis, null);
  return position.every((value) => value === null) ? constraint : { ...constraint, position };
}

/** Seconds in the middle of a constraint. */
export function middle(constraint, whole) {
  const [begin, end] = span(constraint, whole);
  return (begin + end) / 2;
}

/** The constraint with one of its handles elsewhere. */
export function withHandle(constraint, at, [x, y, z]) {
  if (constraint.type === "path") return { ...constraint, points: constraint.points.with(at, place([x, z])) };
  if (constraint.type === "waypoint") return { ...constraint, position: place([x, z]) };
  const free = constraint.position.map((value) => value === null);
  return { ...constraint, position: place([x, Math.max(y, 0), z]).map((value, axis) => (free[axis] ? null : value)) };
}

/** A path out of what was drawn: straightened, and from the origin, where clips begin. */
export function drawnPath(points) {
  const from = Math.hypot(...points[0]) > NEAR ? [[0, 0], ...points] : [[0, 0], ...points.slice(1)];
  let slack = SLACK;
  let line = from;
  do line = straightened(from, slack);
  while (line.length > MOST_POINTS && (slack *= 1.5));
  return { type: "path", points: line.map(place) };
}

/** Fewer points of a line, none further from it than `slack` (Douglas and Peucker, 1973). */
export function straightened(points, slack) {
  if (points.length < 3) return points;
  const [[ax, az], [bx, bz]] = [points[0], points.at(-1)];
  const length = Math.hypot(bx - ax, bz - az);
  const far = points.map(([x, z]) => (length ? Math.abs((bx - ax) * (az - z) - (ax - x) * (bz - az)) / length : Math.hypot(x - ax, z - az)));
  const at = far.indexOf(Math.max(...far.slice(1, -1)), 1);
  if (far[at] <= slack) return [points[0], points.at(-1)];
  return [...straightened(points.slice(0, at + 1), slack).slice(0, -1), ...straightened(points.slice(at), slack)];
}

/** Constraints that still fit a timeline: none later than its end, and paths that are drawn on the whole as they are. */
export function fitted(constraints, whole) {
  return constraints.map((constraint) => {
    const [, end] = span(constraint, whole);
    return end > whole ? shifted(constraint, whole - end, Math.max(whole, end)) : constraint;
  });
}

/** "0,0 1,2" -> [[0, 0], [1, 2]], or null. */
export function pointsOf(text) {
  const points = text.trim().split(/\s+/).map((pair) => pair.split(",").map(Number));
  return points.length >= 2 && points.every((pair) => pair.length === 2 && pair.every(Number.isFinite)) ? points : null;
}

export const textOf = (points) => points.map((pair) => pair.join(",")).join(" ");
