// Figures: a canvas with its caption for each panel, and the cursor that they share.

import { shown } from "./axes.js";
import { made } from "./controls.js";
import { described, draw, nearest, readout, theme, titleOf } from "./plot.js";

export const figures = new Map(); // by the name of the panel
let cursor = null;
let page = null; // how lines look, and how something is said

// A figure for every panel, in their order under `root`; those of other panels go.
export function placed(root, panels, around) {
  page = around;
  const kept = new Set(panels.map((panel) => panel.id));
  for (const [id, figure] of figures) {
    if (kept.has(id)) continue;
    figure.root.remove();
    figures.delete(id);
  }
  return panels.map((panel, k) => {
    if (!figures.has(panel.id)) figures.set(panel.id, figureOf(panel.id));
    const figure = figures.get(panel.id);
    if (root.children[k] !== figure.root) root.insertBefore(figure.root, root.children[k] ?? null);
    figure.root.classList.toggle("first", k === 0);
    return figure;
  });
}

export const paintAll = () => figures.forEach(paint);

function figureOf(id) {
  const caption = made("span"), told = made("span", { class: "told", "aria-hidden": "true" });
  const canvas = made("canvas", { tabindex: "0", role: "img", "data-panel": id });
  const root = made("figure", {}, made("figcaption", {}, caption, told), canvas);
  const figure = { root, caption, told, canvas, panel: null, area: null };
  canvas.addEventListener("pointermove", (event) => {
    const x = (event.offsetX - figure.area.left) / figure.area.width;
    const { low, high } = figure.panel.x;
    setCursor(x < 0 || x > 1 ? null : low + x * (high - low), figure);
  });
  canvas.addEventListener("pointerleave", () => setCursor(null, figure));
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1, PageDown: -20, PageUp: 20 }[event.key];
    const line = figure.panel.lines[0];
    if (event.key === "Escape") return setCursor(null, figure);
    if ((step === undefined && event.key !== "Home" && event.key !== "End") || !line) return;
    event.preventDefault();
    const x = line.x, last = x.length - 1;
    const here = cursor === null ? 0 : nearest(x, cursor);
    const next = event.key === "Home" ? 0 : event.key === "End" ? last : here + step * Math.max(1, Math.round(last / 200));
    setCursor(x[Math.min(last, Math.max(0, next))], figure);
    page.say(`${shown(cursor)}: ${readout(figure.panel, cursor)}`);
  });
  return figure;
}

function setCursor(at, owner) {
  cursor = at;
  const shared = owner.panel.about === undefined;
  for (const figure of figures.values()) {
    if (shared || figure === owner) paint(figure);
  }
}

export function paint(figure) {
  const { canvas, panel } = figure;
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (!width || !panel) return;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  figure.area = draw(context, panel, width, height, theme(), page.style, cursor);
  figure.caption.textContent = titleOf(panel);
  figure.told.textContent = cursor === null ? "" : `at ${shown(cursor)}:  ${readout(panel, cursor)}`;
  canvas.setAttribute("aria-label", described(panel));
}

// A number that tells two drawings apart.
export function digest(panels) {
  let hash = 0;
  for (const panel of panels) for (const line of panel.lines) {
    for (let k = 0; k < line.values.length; k += 7) hash = (hash * 31 + line.values.charCodeAt(k)) | 0;
  }
  return String(hash);
}
