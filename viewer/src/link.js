// A wish as the fragment of a link, which no server sees.
const JSONS = ["graph", "concepts", "foot_fix"];

export function linkOf(wish) {
  const fields = Object.entries(wish).map(([key, value]) => [key, JSONS.includes(key) ? JSON.stringify(value) : String(value)]);
  return `${location.origin}/#${new URLSearchParams(fields)}`;
}

/** The wish of this page's link, or null. */
export function linked() {
  const wish = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
  try {
    for (const key of JSONS) if (key in wish) wish[key] = JSON.parse(wish[key]);
  } catch {
    return null; // not a link of ours
  }
  return wish.text || wish.graph || wish.concepts ? wish : null;
}
