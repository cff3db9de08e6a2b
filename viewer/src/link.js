// A project as the fragment of a link, which no server sees.
const JSONS = ["graph", "concepts", "foot_fix", "texts", "loop", "in_place", "constraints", "layers", "seed_offsets", "root", "fps"];
const OUTPUT = ["fps", "root", "names"];

export function linkOf(wish, output = {}) {
  const fields = Object.entries({ ...wish, ...output }).map(([key, value]) => [key, JSONS.includes(key) ? JSON.stringify(value) : String(value)]);
  return `${location.origin}${location.pathname}#${new URLSearchParams(fields)}`;
}

/** {wish, output} of a link's fragment, or null. */
export function linked(hash = location.hash) {
  const wish = Object.fromEntries(new URLSearchParams(hash.slice(1)));
  delete wish.token;
  const output = {};
  try {
    for (const key of JSONS) if (key in wish) wish[key] = JSON.parse(wish[key]);
  } catch {
    return null; // not a link of ours
  }
  for (const key of OUTPUT) {
    if (key in wish) output[key] = wish[key];
    delete wish[key];
  }
  return wish.text || wish.graph || wish.concepts || wish.texts ? { wish, output } : null;
}
