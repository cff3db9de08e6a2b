// A project as one plain value: what is authored, apart from how it is drawn. Nothing here changes a value in place.
//
//   segments     [{text, graph?, seconds?, offset?}], sentences one after another; a graph stands where it was edited; the
//                offset against the seed of the whole goes with its sentence, which is its place where there is none
//   concepts     null, or {concepts, method, text?, lambdas?, agd?, seconds?} in place of the sentences
//   sampling     {seed?, steps?, guidance?, foot_fix?}, as typed
//   shape        {loop?, in_place?}: true where they are wanted
//   constraints  what the request calls so, times counted from the beginning of the whole
//   layers       [{text, begin, end, weight}], concepts over spans of the timeline
//   output       {fps?, root?, names?}: how files are written
export const MOST_SEGMENTS = 16;
export const MOST_TEXT = 512;
export const SHORTEST = 1; // seconds of a segment that is split or drawn
const MOST_CONSTRAINTS = 32;
const SAMPLING = ["seed", "steps", "guidance", "foot_fix"];
const SHAPE = ["loop", "in_place"];
const OUTPUT = ["fps", "root", "names"];
const LAYER = ["text", "begin", "end", "weight"];
const MIXING = ["concepts", "method", "text", "lambdas", "agd", "seconds"];

export const newProject = (text) => ({
  segments: [{ text }], concepts: null, sampling: {}, shape: {}, constraints: [], layers: [], output: {},
});

function pick(value, keys) {
  return Object.fromEntries(keys.filter((key) => value[key] !== undefined).map((key) => [key, value[key]]));
}

/** The request that a project makes; `seed` goes before its own. */
export function wishOf({ segments, concepts, sampling, shape, constraints, layers = [] }, seed = sampling.seed) {
  let wish;
  if (concepts) wish = { ...concepts };
  else if (segments.length === 1 && !layers.length) wish = pick(segments[0], ["text", "graph", "seconds"]);
  else {
    wish = { texts: segments.map(({ text, graph }) => graph ?? text) };
    if (segments.every(({ seconds }) => seconds)) wish.seconds = segments.map(({ seconds }) => Number(seconds));
    const offsets = numbered(segments).map(({ offset }) => offset);
    if (segments.length > 1 && offsets.some((offset, at) => offset !== at)) wish.seed_offsets = offsets;
    if (layers.length) wish.layers = layers;
  }
  Object.assign(wish, sampling, shape);
  delete wish.seed;
  if (seed !== undefined) wish.seed = String(seed);
  if (constraints.length) wish.constraints = constraints;
  return wish;
}

/** The project that makes a request: `wishOf` backwards. */
export function projectOf(wish, output = {}) {
  const texts = wish.texts ?? [wish.graph ?? wish.text ?? ""];
  const lengths = [].concat(wish.texts ? numbers(wish.seconds) : wish.seconds ?? []);
  const segments = texts.map((said, at) => {
    const segment = typeof said === "string" ? { text: said } : { text: wish.text ?? said.caption, graph: said };
    if (wish.seed_offsets) segment.offset = wish.seed_offsets[at];
    const seconds = lengths.length === 1 ? lengths[0] : lengths[at];
    return seconds === undefined ? segment : { ...segment, seconds };
  });
  const base = { sampling: pick(wish, SAMPLING), shape: pick(wish, SHAPE), constraints: wish.constraints ?? [], layers: wish.layers ?? [], output: pick(output, OUTPUT) };
  if (wish.concepts) return { segments: [{ text: wish.text ?? "" }], concepts: pick(wish, MIXING), ...base };
  return { segments, concepts: null, ...base };
}

function numbers(value) {
  if (value === undefined) return [];
  return Array.isArray(value) ? value : String(value).split(",").map(Number);
}

/** What two projects share if they only differ in seed and files: takes of one another. */
export const kindOf = (project) => JSON.stringify(wishOf(project, ""));

export const isSequence = ({ segments, concepts }) => !concepts && segments.length > 1;

// -- segments --------------------------------------------------------------------------------------------------------

const withSegments = (project, segments) => ({ ...project, segments });

/** Segments with their offsets, which so stay as they are when others come, go or move. */
function numbered(segments) {
  return segments.map((segment, at) => ({ ...segment, offset: segment.offset ?? at }));
}

export function withSegment(project, at, change) {
  return withSegments(project, project.segments.map((segment, k) => (k === at ? { ...segment, ...change } : segment)));
}

export function inserted(project, at, segment) {
  if (project.segments.length >= MOST_SEGMENTS) return project;
  const segments = numbered(project.segments);
  const offset = 1 + Math.max(...segments.map((other) => other.offset));
  return withSegments(project, segments.toSpliced(at, 0, { ...segment, offset }));
}

export function removed(project, at) {
  return project.segments.length === 1 ? project : withSegments(project, numbered(project.segments).toSpliced(at, 1));
}

export function moved(project, from, to) {
  if (to < 0 || to >= project.segments.length || from === to) return project;
  const segments = numbered(project.segments);
  const [segment] = segments.splice(from, 1);
  return withSegments(project, segments.toSpliced(to, 0, segment));
}

/** Cut a segment in two of the same words, `seconds` after its beginning; both must last as long as they may. */
export function split(project, at, seconds, shortest = SHORTEST) {
  const whole = Number(project.segments[at].seconds);
  if (!(seconds >= shortest && whole - seconds >= shortest)) return project;
  const first = withSegment(project, at, { seconds: rounded(seconds) });
  return inserted(first, at + 1, { ...project.segments[at], seconds: rounded(whole - seconds) });
}

/** Cut the segment at a time of the whole, where that leaves two that are long enough. */
export function cutAt(project, time, shortest = SHORTEST) {
  const { at, into } = segmentAt(project, time);
  return split(project, at, rounded(into), shortest);
}

export const rounded = (seconds) => Math.round(seconds * 20) / 20;

/** Beginning of every segment, and the end of the last: seconds. */
export function edges(project) {
  return project.segments.reduce((found, { seconds }) => [...found, rounded(found.at(-1) + Number(seconds ?? 0))], [0]);
}

/** Segment at a time, and how far into it that is. */
export function segmentAt(project, time) {
  const found = edges(project);
  const at = Math.max(0, Math.min(found.findLastIndex((edge) => edge <= time + 1e-9), project.segments.length - 1));
  return { at, into: time - found[at] };
}

// -- what comes from elsewhere ---------------------------------------------------------------------------------------

const isObject = (value) => typeof value === "object" && value !== null && !Array.isArray(value);
const isLayer = (value) => isObject(value) && typeof value.text === "string" && [value.begin, value.end, value.weight].every(Number.isFinite);

/** A project out of JSON of a file or of the browser; an error says what is wrong. Its values the server checks. */
export function checked(value) {
  const refuse = (what) => {
    throw new Error(`This is no project of kinegraph: ${what}.`);
  };
  if (!isObject(value) || !Array.isArray(value.segments)) refuse("it has no segments");
  if (value.segments.length < 1 || value.segments.length > MOST_SEGMENTS) refuse(`it may have 1 to ${MOST_SEGMENTS} segments`);
  for (const segment of value.segments) {
    if (!isObject(segment) || typeof segment.text !== "string" || segment.text.length > MOST_TEXT) refuse("a segment has no text");
    if (segment.graph !== undefined && !Array.isArray(segment.graph?.actions)) refuse("a graph has no actions");
    if (segment.offset !== undefined && !(Number.isInteger(segment.offset) && segment.offset >= 0)) refuse("an offset is no number");
  }
  const { concepts = null, constraints = [], layers = [] } = value;
  if (concepts !== null && !(isObject(concepts) && Array.isArray(concepts.concepts))) refuse("its concepts are no list");
  if (!Array.isArray(constraints) || constraints.length > MOST_CONSTRAINTS) refuse("its constraints are no list");
  if (!Array.isArray(layers) || layers.length > MOST_CONSTRAINTS || !layers.every(isLayer)) refuse("its layers are no list of concepts");
  for (const key of ["sampling", "shape", "output"]) if (!isObject(value[key] ?? {})) refuse(`${key} is no object`);
  return {
    segments: value.segments.map((segment) => pick(segment, ["text", "graph", "seconds", "offset"])),
    concepts: concepts && pick(concepts, MIXING),
    sampling: pick(value.sampling ?? {}, SAMPLING),
    shape: pick(value.shape ?? {}, SHAPE),
    constraints,
    layers: layers.map((layer) => pick(layer, LAYER)),
    output: pick(value.output ?? {}, OUTPUT),
  };
}
