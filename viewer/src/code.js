// What is seen, as a program in Python and as a command: both make the very file that the page downloads.
const SAMPLING = ["seconds", "seed", "steps", "guidance"];

/** A JSON value as Python writes it. */
export function literal(value) {
  if (Array.isArray(value)) return `[${value.map(literal).join(", ")}]`;
  if (value && typeof value === "object") {
    return `{${Object.entries(value).map(([key, part]) => `${literal(key)}: ${literal(part)}`).join(", ")}}`;
  }
  if (value === null || value === undefined) return "None";
  if (typeof value === "boolean") return value ? "True" : "False";
  return JSON.stringify(value);
}

/** A number or several, as typed, as Python writes them: "2.5", "(8, 8, 10)". */
function typed(value) {
  const parts = Array.isArray(value) ? value : String(value).split(",").map((part) => part.trim());
  return parts.length > 1 ? `(${parts.join(", ")})` : parts[0];
}

function pythonOptions(wish, names) {
  const options = names.filter((name) => wish[name] !== undefined).map((name) => `${name}=${typed(wish[name])}`);
  return wish.foot_fix === false ? [...options, "foot_fix=False"] : options;
}

/** Sentences of which each begins in the last pose of the one before. */
const isTimeline = ({ texts, constraints, layers }) => Boolean(texts && (constraints || layers));

const called = (name, parts) => {
  const line = `${name}(${parts.join(", ")})`;
  return line.length <= 100 ? line : `${name}(\n    ${parts.join(",\n    ")},\n)`;
};

/**
 * @param wish the request, with its seed
 * @param output {fps, root, names}
 * @param file name of the file to write
 * @param character name of the character's file, or null
 */
export function python(wish, output, file, character = null) {
  const graphs = [];
  const said = (text) => {
    if (typeof text === "string") return literal(text);
    graphs.push(`SemanticGraph.from_dict(${literal(text)})`);
    return graphs.length > 1 ? `graph_${graphs.length}` : "graph";
  };
  const options = pythonOptions(wish, SAMPLING);
  if (wish.constraints) options.push("constraints=constraints");
  let made;
  if (wish.concepts) {
    const concepts = wish.concepts.map(({ text, weight = 1 }) => `Concept(${literal(text)}${weight === 1 ? "" : `, ${weight}`})`);
    const mixing = [];
    if (wish.method && wish.method !== "auto") mixing.push(`method=${literal(wish.method)}`);
    if (wish.text) mixing.push(`text=${literal(wish.text)}`);
    mixing.push(...["lambdas", "agd"].filter((name) => wish[name]).map((name) => `${name}=${typed(wish[name])}`));
    made = called("pipe.compose", [`[${concepts.join(", ")}]`, ...mixing, ...options]);
  } else if (wish.texts) {
    const texts = `[${wish.texts.map(said).join(", ")}]`;
    if (wish.layers) options.push("layers=layers");
    if (wish.seed_offsets) options.push(`seed_offsets=${literal(wish.seed_offsets)}`);
    made = isTimeline(wish) ? called("generate_timeline", ["pipe", texts, ...options]) : called("pipe.sequence", [texts, ...options]);
  }
  else made = called("pipe.generate", [said(wish.graph ?? wish.text), ...options]);
  const named = ["MotionPipeline", ...(wish.concepts ? ["Concept"] : [])].sort();
  const lines = [`from kinegraph import ${named.join(", ")}`];
  if (graphs.length) lines.push("from kinegraph.graph import SemanticGraph");
  if (wish.constraints) lines.push("from kinegraph.formats import constraints_json");
  if (wish.layers) lines.push("from kinegraph.layers import Layer");
  if (isTimeline(wish)) lines.push("from kinegraph.timeline import generate_timeline");
  lines.push("", "pipe = MotionPipeline.load()");
  lines.push(...graphs.map((graph, at) => `${at ? `graph_${at + 1}` : "graph"} = ${graph}`));
  if (wish.constraints) lines.push(`constraints = constraints_json.decode([\n${wish.constraints.map((one) => `    ${literal(one)},\n`).join("")}])`);
  if (wish.layers) lines.push(`layers = [\n${wish.layers.map(({ text, begin, end, weight }) => `    Layer(${literal(text)}, ${begin}, ${end}, ${weight}),\n`).join("")}]`);
  lines.push(`clip = ${made}`);
  const loop = wish.foot_fix === false ? ".looped(foot_fix=False)" : ".looped()";
  const shape = [wish.loop && loop, wish.in_place && ".in_place()"].filter(Boolean).join("");
  if (shape) lines.push(`clip = clip${shape}`);
  lines.push(saved(output, file, character));
  return `${lines.join("\n")}\n`;
}

function saved({ fps, root, names }, file, character) {
  if (character) {
    const options = [literal(character), ...(fps ? [`fps=${fps}`] : []), ...(root ? ["root=True"] : [])];
    return `clip.onto(${options.join(", ")}).save(${literal(file)})`;
  }
  const named = /\.(glb|bvh)$/.test(file);
  const options = [literal(file)];
  if (named && names && names !== "smpl") options.push(`names=${literal(names)}`);
  if (named && root) options.push("root=True");
  return `clip${fps ? `.resampled(${fps})` : ""}.save(${options.join(", ")})`;
}

/** Words for a POSIX shell. */
export const quoted = (text) => (/^[\w./:=,+-]+$/.test(text) ? text : `'${text.replaceAll("'", `'\\''`)}'`);

/** The command, or a line that says why there is none. */
export function command(wish, output, file, character = null) {
  const words = ["kinegraph"];
  let input = "";
  if (wish.concepts) {
    words.push("compose");
    for (const { text, weight = 1 } of wish.concepts) {
      const size = Math.abs(weight);
      words.push(weight < 0 ? "--not" : "--and", size === 1 && !text.includes(":") ? text : `${text}:${size}`);
    }
    if (wish.method && wish.method !== "auto") words.push("--method", wish.method);
    for (const name of ["text", "lambdas", "agd"]) if (wish[name]) words.push(`--${name}`, String(wish[name]));
  } else if (wish.texts) {
    if (wish.texts.some((text) => typeof text !== "string")) return "# a sequence with edited graphs: use Python\n";
    if (isTimeline(wish)) return "# a timeline with constraints or concepts: use Python\n";
    words.push("sequence", ...wish.texts);
    if (wish.seed_offsets) words.push("--seed-offsets", wish.seed_offsets.join(","));
  } else if (wish.graph) {
    words.push("generate", "--graph", "-");
    input = ` <<'END'\n${JSON.stringify(wish.graph)}\nEND`;
  } else words.push("generate", wish.text);
  for (const name of SAMPLING) if (wish[name] !== undefined) words.push(`--${name}`, String(wish[name]).replaceAll(" ", ""));
  if (wish.foot_fix === false) words.push("--no-foot-fix");
  if (wish.loop) words.push("--loop");
  if (wish.in_place) words.push("--in-place");
  if (output.fps) words.push("--fps", String(output.fps));
  const named = /\.(glb|bvh)$/.test(file);
  if (output.root && (named || character)) words.push("--root");
  if (character) words.push("--character", character);
  else if (named && output.names && output.names !== "smpl") words.push("--names", output.names);
  words.push("-o", file);
  if (!wish.constraints) return `${words.map(quoted).join(" ")}${input}\n`;
  const kept = `cat > constraints.json <<'END'\n${JSON.stringify(wish.constraints)}\nEND\n`;
  return `${kept}${[...words, "--constraints", "constraints.json"].map(quoted).join(" ")}${input}\n`;
}
