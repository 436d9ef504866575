// Sliders with exact entries beside them, one for each knob.

import { shown } from "./axes.js";

const STEPS = 1000;
const CLOSED = ["Offsets", "Start", "Speed"];

// From a place of the slider, 0 to STEPS, to a value, and back.
export function valueAt(knob, position) {
  const share = position / STEPS;
  if (knob.scale === "linear") {
    const value = knob.low + share * (knob.high - knob.low);
    const step = (knob.high - knob.low) / STEPS;
    return Math.abs(value) < step / 2 ? 0 : Number(value.toPrecision(4));
  }
  if (knob.scale === "zero-log" && position === 0) return 0;
  return Number((knob.low * (knob.high / knob.low) ** share).toPrecision(4));
}

export function positionOf(knob, value) {
  if (knob.scale === "linear") return (STEPS * (value - knob.low)) / (knob.high - knob.low);
  if (value <= knob.low) return 0;
  return (STEPS * Math.log(value / knob.low)) / Math.log(knob.high / knob.low);
}

const percent = (knob) => knob.group === "Parameter errors";
const asText = (knob, value) => (percent(knob) ? `${Number((100 * value).toPrecision(4))}` : shown(value).replace("−", "-").replace("e−", "e-"));
const unitOf = (knob) => (percent(knob) ? "%" : knob.unit);

let count = 0;

export function made(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name in element && name !== "list" && typeof value !== "string") element[name] = value;
    else element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

// Groups of knobs; `moved(key, value, settled)` is told of every change, with null for the
// default, and `tune(observer)` of a wish to tune.
export function build(root, knobs, values, observers, { moved, tune, tunes }) {
  const open = new Map([...root.querySelectorAll("details")].map((d) => [d.dataset.group, d.open]));
  root.replaceChildren();
  const narrow = matchMedia("(max-width: 62rem)").matches;
  const groups = new Map();
  for (const knob of knobs) {
    if (!groups.has(knob.group)) groups.set(knob.group, []);
    groups.get(knob.group).push(knob);
  }
  for (const [name, members] of groups) {
    const details = made("details", { "data-group": name }, made("summary", {}, name));
    details.open = open.get(name) ?? !(narrow || CLOSED.includes(name));
    for (const knob of members) {
      details.append(knob.scale === "choice" ? choice(knob, values, moved) : slider(knob, values, moved));
    }
    const observer = observers.find((each) => name === `Gains of ${each.name}`);
    if (observer && tunes && members.some((knob) => knob.scale === "log")) {
      const button = made("button", { type: "button", "data-tune": observer.name }, "Tune from here");
      button.setAttribute("aria-label", `Tune the gains of ${observer.name} from here`);
      const said = made("span", { "data-tuned": observer.name });
      button.addEventListener("click", () => tune(observer.name, button, said));
      details.append(made("div", { class: "tune" }, button, said));
    }
    root.append(details);
  }
}

function slider(knob, values, moved) {
  const id = `knob${count++}`;
  const unit = unitOf(knob);
  const label = made("label", { for: id }, knob.label, " ", made("span", { class: "unit" }, unit === "1" ? "" : unit));
  const bar = made("input", { type: "range", id, min: "0", max: String(STEPS), step: "1", "data-key": knob.key });
  const entry = made("input", { type: "text", inputmode: "decimal", "aria-label": `${knob.label}, ${knob.group}, exactly`, "data-entry": knob.key });
  const back = made("button", { type: "button", title: "Back to the default" }, "↺");
  back.setAttribute("aria-label", `${knob.label}, ${knob.group}: back to ${asText(knob, knob.default)} ${unit}`);
  const row = made("div", { class: "knob" }, label, entry, back, bar);
  const show = (value) => {
    bar.value = String(Math.round(positionOf(knob, value)));
    bar.setAttribute("aria-valuetext", `${asText(knob, value)} ${unit}`.trim());
    entry.value = asText(knob, value);
    row.classList.toggle("moved", value !== knob.default);
  };
  show(values[knob.key] ?? knob.default);
  const tell = (value, settled) => {
    show(value);
    moved(knob.key, value === knob.default ? null : value, settled);
  };
  bar.addEventListener("input", () => tell(valueAt(knob, Number(bar.value)), false));
  bar.addEventListener("change", () => tell(valueAt(knob, Number(bar.value)), true));
  entry.addEventListener("change", () => {
    const typed = Number(entry.value.replace(",", ".").replace("−", "-"));
    const low = knob.scale === "zero-log" ? 0 : knob.low;
    const value = percent(knob) ? typed / 100 : typed;
    const right = entry.value.trim() !== "" && value >= low && value <= knob.high;
    entry.setAttribute("aria-invalid", String(!right));
    const limit = `${asText(knob, low)} to ${asText(knob, knob.high)} ${unit}`;
    entry.title = right ? "" : `From ${limit}`;
    if (right) tell(value, true);
  });
  back.addEventListener("click", () => {
    tell(knob.default, true);
    bar.focus();
  });
  row.show = show;
  return row;
}

function choice(knob, values, moved) {
  const id = `knob${count++}`;
  const words = { exact: "exact", paper: "printed" };
  const options = knob.options.map((each) => made("option", { value: each }, words[each] ?? each));
  const select = made("select", { id, "data-key": knob.key }, ...options);
  select.value = values[knob.key] ?? knob.default;
  select.addEventListener("change", () => moved(knob.key, select.value === knob.default ? null : select.value, true));
  return made("div", { class: "knob" }, made("label", { for: id }, knob.label), select);
}

// A short line in the colour and dashes of an observer.
export function swatch(colour, dash) {
  const space = "http://www.w3.org/2000/svg";
  const svg = document.createElementNS(space, "svg");
  const line = document.createElementNS(space, "line");
  for (const [name, value] of Object.entries({ width: 30, height: 8, "aria-hidden": "true" })) svg.setAttribute(name, value);
  const look = { x1: 1, x2: 29, y1: 4, y2: 4, stroke: colour, "stroke-width": 2.4, "stroke-dasharray": dash.join(" ") || "none" };
  for (const [name, value] of Object.entries(look)) line.setAttribute(name, value);
  svg.append(line);
  return svg;
}
