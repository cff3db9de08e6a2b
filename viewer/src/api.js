// The server's five calls. It keeps nothing about us; the tab's number only says whose turn it is.
const TAB = crypto.getRandomValues(new Uint32Array(2)).join("-");

async function post(path, value, signal) {
  let answer;
  try {
    const headers = { "Content-Type": "application/json", "Kinegraph-Tab": TAB };
    answer = await fetch(path, { method: "POST", body: JSON.stringify(value), signal, headers });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Error("The server does not answer. Is kinegraph play still running?");
  }
  if (!answer.ok) throw new Error(await answer.json().then(({ error }) => error, () => `The server says ${answer.status}.`));
  return answer;
}

export const parse = async (text, signal) => (await post("/api/parse", { text }, signal)).json();

export const edit = async (graph, change) => (await post("/api/edit", { graph, edit: change })).json();

/** What the bundle was never shown in a graph's sentence. */
export const unknown = async (graph, signal) => (await post("/api/unknown", { graph }, signal)).json();

/** The file of the clip that a wish with a seed makes. */
export const file = async (wish, suffix, names) => (await post("/api/file", { wish, suffix, names })).blob();

/** Events of a clip in the making, as they come; leaving the loop or aborting stops the server, too. */
export async function* clip(wish, signal) {
  const reader = (await post("/api/clip", wish, signal)).body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  try {
    for (;;) {
      const { value, done } = await reader.read();
      if (done) return;
      const lines = (rest + value).split("\n");
      rest = lines.pop();
      for (const line of lines) yield JSON.parse(line);
    }
  } finally {
    await reader.cancel().catch(() => {}); // aborted already
  }
}
