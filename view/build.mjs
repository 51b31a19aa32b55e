// Bundles the view into one file; the same sources and versions give the same bytes.
// usage: node build.mjs OUTPUT
import { createHash } from "node:crypto";
import { readFileSync, readdirSync } from "node:fs";
import { build } from "esbuild";

const here = new URL(".", import.meta.url);
const sources = readdirSync(new URL("src/", here)).sort().map((name) => `src/${name}`);
const hash = createHash("sha256");
for (const name of ["build.mjs", "package-lock.json", "tsconfig.json", ...sources]) {
  hash.update(name).update("\0").update(readFileSync(new URL(name, here))).update("\0");
}
await build({
  entryPoints: [new URL("src/main.ts", here).pathname],
  outfile: process.argv[2],
  bundle: true,
  minify: true,
  format: "iife",
  target: "es2022",
  charset: "utf8",
  legalComments: "inline",
  loader: { ".css": "text" },
  absWorkingDir: here.pathname,
  banner: { js: `/* Made from view/ by "npm run build"; sources sha256 ${hash.digest("hex")} */` },
});
