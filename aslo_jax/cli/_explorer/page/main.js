// The page: asks for a run and a band at every change, and draws what is newest.

import { shown } from "./axes.js";
import { build, made, swatch } from "./controls.js";
import { digest, figures, paint, paintAll, placed } from "./figures.js";
import { DASHES, prepared, theme, unpacked } from "./plot.js";
import { controls as resultControls, table as resultTable } from "./results.js";
import { exportButtons } from "./save.js";
import { pruned, read, written } from "./state.js";

const $ = (id) => document.getElementById(id);
const client = crypto.randomUUID();
// What takes longer than a second or two to compile.
const SLOW = { adaptive: " (half a minute to compile)" };
const SETTLED = 700; // ms without a change, after which it is said aloud

let state = read(location.search);
let about = null;
let number = 0; // of the newest request
let epoch = 0; // of observers and knobs: what was asked before another is not drawn
let run = null, band = null;
let looks = new Map(); // colour and dashes of every observer

async function get(what, query, more = "") {
  const answer = await fetch(`/api/${what}?${query}${more}`, { cache: "no-store" }).catch(() => {
    throw new Error("The explorer has ended: start it again in the terminal.");
  });
  const content = await answer.json();
  if (answer.status === 409) return null;
  if (!answer.ok) throw new Error(content.error);
  return content;
}

// One request after the other, always for the newest state, dropping what is older.
function pump(what, arrived) {
  let busy = false, done = 0;
  return async () => {
    if (busy) return;
    busy = true;
    while (done < number) {
      const n = number, then = epoch;
      try {
        const found = await get(what, written(state), `&n=${n}&client=${client}`);
        if (found && found.n === n && then === epoch) arrived(found);
        if (what === "run") problem("");
      } catch (error) {
        if (n === number) problem(error);
      }
      done = n;
    }
    busy = false;
  };
}

const pumpRun = pump("run", (found) => {
  const first = run === null;
  run = found;
  redraw();
  // The band compiles a loop of its own: after the plot, not beside it.
  if (first && state.source !== "results") pumpBand();
  if (found.n === number) document.body.dataset.busy = "false";
  say();
});
const pumpBand = pump("band", (found) => {
  band = found;
  redraw();
  document.body.dataset.banded = String(found.n);
  say();
});

let bandTimer = 0, addressTimer = 0, aloudTimer = 0;

function request(settled = true) {
  number += 1;
  document.body.dataset.busy = "true";
  pumpRun();
  clearTimeout(bandTimer);
  if (state.source === "results" || run === null) return keepAddress();
  // A log is replayed by all runs at every row: once the slider rests.
  if (state.source === "log" && !settled) bandTimer = setTimeout(pumpBand, 250);
  else pumpBand();
  keepAddress();
}

function keepAddress() {
  clearTimeout(addressTimer);
  addressTimer = setTimeout(() => history.replaceState(null, "", `?${written(state)}`), 200);
}

function problem(error) {
  const text = error ? error.message : "";
  $("problem").textContent = text;
  $("problem").hidden = !text;
  if (text) $("status").textContent = "What is drawn belongs to the settings before.";
}

function notice(text) {
  $("notice").textContent = $("announce").textContent = text;
  $("notice").hidden = !text;
}

// Sources, observers and knobs of the state as it is now.
async function load() {
  const mine = ++epoch;
  try {
    const found = await get("about", written(state));
    if (mine !== epoch) return; // another choice was made meanwhile
    about = found;
  } catch (error) {
    if (mine === epoch) problem(error);
    return;
  }
  problem("");
  state.source = about.source;
  state = pruned(state, about.knobs);
  looks = new Map(about.observers.map((each, k) => [each.name, k]));
  document.title = `${about.title} – aslo_jax explorer`;
  const results = state.source === "results";
  $("source").replaceChildren(...about.sources.map((s) => made("option", { value: s.id }, s.title)));
  $("source").value = state.source;
  $("source").disabled = false;
  $("horizon-field").hidden = !about.horizons.length;
  const lengths = [...new Set([...about.horizons, about.horizon])].filter((h) => h !== null).sort((a, b) => a - b);
  $("horizon").replaceChildren(...lengths.map((h) => made("option", { value: String(h) }, `${shown(h)} s`)));
  if (about.horizon !== null) $("horizon").value = String(about.horizon);
  $("seed").value = state.seed;
  $("tolerance").value = state.tolerance;
  $("controls").hidden = results;
  document.querySelector(".bench").style.gridTemplateColumns = results ? "minmax(0, 1fr)" : "";
  observerBoxes();
  build($("knobs"), about.knobs, state.values, about.observers, { moved, tune, tunes: about.tunes });
  const told = about.observers.filter((each) => each.shown);
  $("export").hidden = results;
  $("export-observer").replaceChildren(
    ...told.map((each) => made("option", { value: each.name }, each.described ? each.name : `${each.name} (study only)`)),
  );
  exportButtons($("export-buttons"), about.exports, { query: () => written(state), sheet, problem, title: () => about.title });
  run = band = null;
  request();
}

function observerBoxes() {
  const root = $("observers");
  const focused = document.activeElement?.dataset?.observer;
  root.replaceChildren(root.querySelector("legend"));
  for (const each of about.observers) {
    const box = made("input", { type: "checkbox", id: `observer-${looks.get(each.name)}`, "data-observer": each.name });
    box.checked = each.shown;
    box.addEventListener("change", () => {
      const boxes = [...root.querySelectorAll("input")];
      const chosen = boxes.filter((b) => b.checked).map((b) => b.dataset.observer);
      if (!chosen.length) {
        box.checked = true;
        $("announce").textContent = "At least one observer is shown.";
        return;
      }
      state.observers = chosen;
      load();
    });
    const { colour, dash } = style(each.name);
    root.append(made("div", { class: "observer" }, box, swatch(colour, dash), made("label", { for: box.id }, each.name, SLOW[each.kind] ?? "")));
    if (each.name === focused) box.focus();
  }
}

function style(name) {
  if (!looks.has(name)) looks.set(name, looks.size);
  const k = looks.get(name);
  return { colour: theme().lines[k % 8], dash: DASHES[k % DASHES.length] };
}

function moved(key, value, settled) {
  notice("");
  if (value === null) delete state.values[key];
  else state.values[key] = value;
  request(settled);
}

async function tune(observer, button, said) {
  button.disabled = true;
  said.textContent = "by gradients, over 64 runs …";
  try {
    const found = await get("tune", written(state), `&n=${++tunings}&client=${client}&observer_name=${encodeURIComponent(observer)}`);
    if (!found) return;
    if (found.improved) Object.assign(state.values, found.values);
    const change = `rms ${shown(found.before)} → ${shown(found.after)}`;
    await load();
    const place = document.querySelector(`[data-tuned="${CSS.escape(observer)}"]`);
    const text = found.improved ? change : `no better gains: ${change}`;
    if (place) place.textContent = text;
    $("announce").textContent = `${observer}: ${text}`;
  } catch (error) {
    problem(error);
  } finally {
    button.disabled = false;
  }
}
let tunings = 0;

function bands() {
  if (!band || !band.t) return null;
  const of = {};
  for (const [name, each] of Object.entries(band.bands)) {
    if (run.panels[0].lines.some((line) => line.observer === name)) {
      of[name] = { low: unpacked(each.low), middle: unpacked(each.middle), high: unpacked(each.high), runs: each.runs };
    }
  }
  return { t: unpacked(band.t), of, old: band.n !== run.n };
}

// Everything that is drawn, from what has arrived.
function redraw() {
  if (!run) return;
  const t = run.t ? unpacked(run.t) : null;
  const ranges = bands();
  const shownNow = placed($("panels"), run.panels, { style, say: (text) => { $("announce").textContent = text; } });
  for (const [k, figure] of shownNow.entries()) {
    figure.panel = prepared(run.panels[k], t, ranges);
    paint(figure);
  }
  if (run.t) summary(); else resultTable($("summary"), run, style, openSample);
  $("results").hidden = !!run.t;
  if (!run.t) resultControls($("results"), run, { against, openSample });
  const body = document.body.dataset;
  body.drawn = String(run.n);
  body.traced = String(Math.max(run.traced ?? 0, band?.traced ?? 0));
  body.digest = digest(run.panels);
}

function summary() {
  const unit = run.unit ? ` (${run.unit})` : "";
  const heads = ["observer", `rms error${unit}`, `peak error${unit}`];
  const angle = run.table.some((row) => row.angle !== undefined);
  if (angle) heads.push("rms of the angle (deg)");
  heads.push("mean residual", "certified");
  const rows = run.table.map((row) => {
    const { colour, dash } = style(row.observer);
    const cells = [shown(row.rms), shown(row.peak)];
    if (angle) cells.push(shown(row.angle));
    cells.push(shown(row.residual), `${shown(100 * row.certified)} %`);
    const head = made("th", { scope: "row" }, swatch(colour, dash), ` ${row.observer}`);
    return made("tr", {}, head, ...cells.map((cell) => made("td", {}, cell)));
  });
  const caption = made("caption", {}, "Errors in the second half of the run");
  const head = made("thead", {}, made("tr", {}, ...heads.map((h) => made("th", { scope: "col" }, h))));
  $("summary").replaceChildren(made("table", {}, caption, head, made("tbody", {}, ...rows)));
}

function say() {
  if (!run) return;
  const parts = [];
  if (run.seconds !== undefined) parts.push(`run ${shown(1000 * run.seconds)} ms`);
  if (band?.t && band.n === run.n) parts.push(`band ${shown(1000 * band.seconds)} ms`);
  else if (band?.note) parts.push(band.note);
  else if (run.t && state.source !== "results") parts.push("band: computing (the first takes a few seconds to compile)");
  parts.push(...(run.notes ?? []));
  $("status").textContent = parts.join("  ·  ");
  clearTimeout(aloudTimer);
  aloudTimer = setTimeout(() => {
    const told = (run?.table ?? []).filter((row) => row.rms !== undefined && row.rms !== null);
    $("announce").textContent = told.map((row) => `${row.observer}: rms error ${shown(row.rms)} ${run.unit}`).join("; ");
  }, SETTLED);
}

async function against(parameter) {
  try {
    const found = await get("against", `parameter=${encodeURIComponent(parameter)}`);
    run = { ...found, n: run.n, parameter };
    redraw();
  } catch (error) {
    problem(error);
  }
}

async function openSample(index) {
  try {
    const found = await get("sample", `index=${index}`);
    state = read(found.query);
    await load();
    const left = found.left.length ? `, and without ${found.left.join(", ")}` : "";
    notice(`Sample ${index} of the study, with other noise${left}.`);
  } catch (error) {
    problem(error);
  }
}

// All panels for a picture, each with its size.
function sheet() {
  return { panels: run.panels.map((panel) => figures.get(panel.id).panel), style, query: written(state) };
}

$("source").addEventListener("change", () => {
  state = read(`source=${encodeURIComponent($("source").value)}`);
  notice("");
  load();
});
$("horizon").addEventListener("change", () => { state.horizon = $("horizon").value; request(); });
for (const name of ["seed", "tolerance"]) {
  $(name).addEventListener("change", () => {
    if (!$(name).checkValidity() || $(name).value === "") return;
    state[name] = $(name).value;
    request();
  });
}
$("reset").addEventListener("click", () => {
  state = read(about ? `source=${encodeURIComponent(about.source)}` : "");
  notice("");
  load();
});
$("link").addEventListener("click", async () => {
  const address = `${location.origin}/?${written(state)}`;
  history.replaceState(null, "", `?${written(state)}`);
  try {
    await navigator.clipboard.writeText(address);
    $("announce").textContent = $("status").textContent = "The address of this state is copied.";
  } catch {
    $("announce").textContent = $("status").textContent = "The address of this page is that of this state.";
  }
});
$("controls").addEventListener("submit", (event) => event.preventDefault());
window.addEventListener("popstate", () => { state = read(location.search); load(); });
new ResizeObserver(paintAll).observe($("panels"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  if (about) observerBoxes();
  redraw();
});
load();
