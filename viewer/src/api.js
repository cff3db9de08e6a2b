// The server's six calls. It keeps nothing about us; the tab's number only says whose turn it is.
const TAB = crypto.getRandomValues(new Uint32Array(2)).join("-");

/** The token of a playground that other devices may use: from the link, which then forgets it, and kept by the tab. */
let token = readToken();
addEventListener("hashchange", () => (token = readToken() ?? token)); // a link that is opened in this tab loads nothing

function readToken() {
  const given = new URLSearchParams(location.hash.slice(1));
  const said = given.get("token");
  try {
    if (said === null) return sessionStorage.getItem("kinegraph-token");
    sessionStorage.setItem("kinegraph-token", said);
  } catch {
    // without storage it lasts until the page is reloaded
  }
  given.delete("token");
  history.replaceState(null, "", given.size ? `#${given}` : location.pathname);
  return said;
}

async function post(path, value, signal, body = JSON.stringify(value), kind = "application/json") {
  let answer;
  try {
    const headers = { "Content-Type": kind, "Kinegraph-Tab": TAB, ...(token && { Authorization: `Bearer ${token}` }) };
    answer = await fetch(path, { method: "POST", body, signal, headers });
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
export const file = async (wish, suffix, options) => (await post("/api/file", { wish, suffix, ...options })).blob();

/** The file of a character that makes the clip of a wish with a seed. */
export async function character(wish, { name, data }, options = {}, signal = undefined) {
  const body = new Blob([JSON.stringify({ wish, name, ...options }), "\n", data]);
  return (await post("/api/character", null, signal, body, "application/octet-stream")).arrayBuffer();
}

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
