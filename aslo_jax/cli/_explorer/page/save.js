// What can be saved: files of the server, and pictures drawn here.

import { made } from "./controls.js";
import { draw, theme } from "./plot.js";
import { VectorContext } from "./vector.js";

const NAMES = {
  toml: "Machine (TOML)",
  csv: "Log (CSV)",
  estimates: "Estimates (CSV)",
  python: "Program (Python)",
  c: "Observer (C, zip)",
  study: "Study (TOML)",
};
const [WIDTH, HEIGHT, HEAD] = [640, 250, 24];

export function exportButtons(root, kinds, page) {
  const button = (id, text, act) => {
    const made_ = made("button", { type: "button", "data-export": id }, text);
    made_.addEventListener("click", async () => {
      made_.disabled = true;
      try {
        await act();
        page.problem("");
      } catch (error) {
        page.problem(error);
      } finally {
        made_.disabled = false;
      }
    });
    return made_;
  };
  root.replaceChildren(
    ...kinds.map((kind) => button(kind, NAMES[kind], () => file(kind, page))),
    button("png", "Picture (PNG)", () => png(page)),
    button("svg", "Picture (SVG)", () => svg(page)),
  );
}

async function file(kind, page) {
  const observer = encodeURIComponent(document.getElementById("export-observer").value);
  const answer = await fetch(`/api/export?${page.query()}&format=${kind}&observer_name=${observer}`);
  if (!answer.ok) throw new Error((await answer.json()).error);
  const name = /filename="([^"]+)"/.exec(answer.headers.get("Content-Disposition"))[1];
  save(name, await answer.blob());
}

function save(name, blob) {
  const link = made("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

// All panels in two columns, each under its title, drawn by `context`.
function sheet(context, page) {
  const { panels, style, query } = page.sheet();
  const colours = theme();
  const { width, height } = size(panels);
  context.fillStyle = colours.card;
  context.fillRect(0, 0, width, height);
  context.fillStyle = colours.ink;
  context.font = '600 14px "DejaVu Sans", sans-serif';
  context.textAlign = "left";
  context.textBaseline = "alphabetic";
  context.fillText(page.title(), 10, 22);
  const names = [...new Set(panels.flatMap((panel) => panel.lines.map((line) => line.observer)))];
  let x = 10;
  context.font = '12px "DejaVu Sans", sans-serif';
  for (const name of names) {
    const { colour, dash } = name === null ? { colour: colours.truth, dash: [] } : style(name);
    context.strokeStyle = colour;
    context.globalAlpha = name === null ? 0.4 : 1;
    context.lineWidth = 2;
    context.setLineDash(dash);
    context.beginPath();
    context.moveTo(x, 38);
    context.lineTo(x + 28, 38);
    context.stroke();
    context.setLineDash([]);
    context.globalAlpha = 1;
    context.fillStyle = colours.ink;
    context.fillText(name ?? "truth", x + 33, 42);
    x += 50 + context.measureText(name ?? "truth").width;
  }
  panels.forEach((panel, k) => {
    context.save();
    context.translate((k % 2) * WIDTH, 2 * HEAD + Math.floor(k / 2) * (HEIGHT + HEAD));
    context.fillStyle = colours.ink;
    context.font = '600 12px "DejaVu Sans", sans-serif';
    context.textAlign = "left";
    context.textBaseline = "alphabetic";
    const unit = panel.unit && panel.unit !== "1" ? ` (${panel.unit})` : "";
    context.fillText(`${panel.title}${unit}`, 10, 18);
    context.translate(0, HEAD);
    draw(context, panel, WIDTH, HEIGHT, colours, style, null);
    context.restore();
  });
  context.fillStyle = colours.soft;
  context.font = '10px "DejaVu Sans", sans-serif';
  context.textAlign = "left";
  context.textBaseline = "alphabetic";
  context.fillText(`aslo-jax explore ?${query}`.slice(0, 220), 10, height - 8);
}

function size(panels) {
  return { width: 2 * WIDTH, height: 2 * HEAD + Math.ceil(panels.length / 2) * (HEIGHT + HEAD) + HEAD };
}

async function png(page) {
  const { width, height } = size(page.sheet().panels);
  const canvas = made("canvas", {});
  [canvas.width, canvas.height] = [2 * width, 2 * height];
  const context = canvas.getContext("2d");
  context.scale(2, 2);
  sheet(context, page);
  save("explored.png", await new Promise((found) => canvas.toBlob(found, "image/png")));
}

async function svg(page) {
  const { width, height } = size(page.sheet().panels);
  const context = new VectorContext(width, height);
  sheet(context, page);
  save("explored.svg", new Blob([context.text()], { type: "image/svg+xml" }));
}
