// The server's four calls. It keeps nothing about us; the tab's number only says whose turn it is.
const TAB = crypto.getRandomValues(new Uint32Array(2)).join("-");

async function post(path, body, type, signal) {
  let answer;
  try {
    answer = await fetch(path, { method: "POST", body, signal, headers: { "Content-Type": type, "Kinegraph-Tab": TAB } });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Error("The server does not answer. Is kinegraph play still running?");
  }
  if (!answer.ok) throw new Error(await answer.json().then(({ error }) => error, () => `The server says ${answer.status}.`));
  return answer;
}

const json = (path, value, signal) => post(path, JSON.stringify(value), "application/json", signal);

export const parse = async (text, signal) => (await json("/api/parse", { text }, signal)).json();

export const edit = async (graph, change) => (await json("/api/edit", { graph, edit: change })).json();

/** A clip's file; npz: its bytes. */
export const file = async (npz, suffix, names) => {
  const query = new URLSearchParams({ suffix, names });
  return (await post(`/api/file?${query}`, npz, "application/octet-stream")).blob();
};

/** Events of a clip in the making, as they come; leaving the loop or aborting stops the server, too. */
export async function* clip(wish, signal) {
  const reader = (await json("/api/clip", wish, signal)).body.pipeThrough(new TextDecoderStream()).getReader();
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
