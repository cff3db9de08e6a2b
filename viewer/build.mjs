// Writes runtime/kinegraph/viewer/{page.html,viewer.css,viewer.js}: what the wheel carries. Run by `npm run build`.
// The script begins with the SHA-256 of its sources, which a test compares: no page can be older than they are.
import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { build } from "esbuild";

const OUT = "../runtime/kinegraph/viewer";
const sources = ["build.mjs", "package.json", "package-lock.json", ...readdirSync("src").sort().map((name) => `src/${name}`)];
const hash = createHash("sha256");
for (const name of sources) hash.update(name + "\0").update(readFileSync(name)).update("\0");

const licence = readFileSync("node_modules/three/LICENSE", "utf8").trim();
const common = { bundle: true, minify: true, target: "es2022", legalComments: "none" };

await build({
  ...common,
  entryPoints: ["src/main.js"],
  format: "iife",
  charset: "utf8",
  outfile: `${OUT}/viewer.js`,
  banner: { js: `/* kinegraph, Apache-2.0; sources sha256 ${hash.digest("hex")}\nIt contains three.js:\n\n${licence} */` },
});
await build({ ...common, entryPoints: ["src/style.css"], outfile: `${OUT}/viewer.css` });
mkdirSync(OUT, { recursive: true });
writeFileSync(`${OUT}/page.html`, readFileSync("src/page.html"));
