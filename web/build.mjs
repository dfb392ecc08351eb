// Bundles the page into the Python package, with the licences of what is in it.
import { build } from "esbuild";
import { copyFile, mkdir, readFile, readdir, rm, writeFile } from "node:fs/promises";
import { fileURLToPath } from "node:url";
import { join } from "node:path";

const here = fileURLToPath(new URL(".", import.meta.url));
const out = join(here, "..", "agent", "page_bundle");

await rm(out, { recursive: true, force: true });
await mkdir(out, { recursive: true });
await build({
  absWorkingDir: here,
  entryPoints: { page: "src/main.ts" },
  bundle: true,
  minify: true,
  format: "iife",
  target: "es2022",
  loader: { ".png": "file" },
  assetNames: "[name]",
  legalComments: "none", // whole licences lie beside the bundle
  outdir: out,
});
const { dependencies } = JSON.parse(await readFile(join(here, "package.json"), "utf8"));
const licences = [];
for (const name of Object.keys(dependencies).sort()) {
  const folder = join(here, "node_modules", name);
  const { version } = JSON.parse(await readFile(join(folder, "package.json"), "utf8"));
  const file = (await readdir(folder)).find((each) => /^licen[cs]e/i.test(each));
  if (file === undefined) throw new Error(`${name} comes without a licence`);
  licences.push(`${name} ${version}\n\n${(await readFile(join(folder, file), "utf8")).trim()}\n`);
}
await writeFile(join(out, "licences.txt"), licences.join(`\n${"-".repeat(80)}\n\n`));
await copyFile(join(here, "src", "icon.svg"), join(out, "icon.svg"));
await copyFile(join(here, "src", "index.html"), join(out, "index.html")); // last: it says that all is there
