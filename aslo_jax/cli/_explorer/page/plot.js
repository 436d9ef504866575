// Panels of lines, drawn on a canvas or as SVG.

import { linear, logarithmic, place, range, shown, usual } from "./axes.js";

export const DASHES = [[], [7, 3], [2, 3], [9, 3, 2, 3], [4, 4], [12, 4], [1, 4], [6, 2, 1, 2]];
const MARGIN = { left: 58, right: 14, top: 10, bottom: 34 };
const FONT = '"DejaVu Sans", sans-serif';

// Numbers as the server packs them.
export function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Float32Array(bytes.buffer);
}

// The colours of the page, as its style has them now.
export function theme() {
  const style = getComputedStyle(document.documentElement);
  const of = (name) => style.getPropertyValue(`--${name}`).trim();
  return {
    ink: of("ink"), soft: of("soft"), grid: of("grid"), rule: of("rule"), card: of("card"),
    truth: of("truth"), lines: [0, 1, 2, 3, 4, 5, 6, 7].map((k) => of(`c${k}`)),
  };
}

// A panel with its arrays, and the axes that fit them.
export function prepared(panel, t, bands) {
  const lines = panel.lines.map((line) => ({
    ...line,
    values: unpacked(line.values),
    x: line.x ? unpacked(line.x) : t,
    coasting: line.coasting ? unpacked(line.coasting) : null,
    low: line.low ? unpacked(line.low) : null,
    high: line.high ? unpacked(line.high) : null,
  }));
  const ready = { ...panel, lines, bands: panel.id === "error" ? bands : null };
  const drawn = lines.flatMap((l) => [l.values, l.low, l.high].filter(Boolean));
  if (ready.bands) for (const b of Object.values(ready.bands.of)) drawn.push(b.high, b.middle);
  const truth = lines.find((l) => l.observer === null);
  const [low, high] = panel.log ? range(drawn, true) : usual(drawn, truth?.values);
  ready.y = panel.log ? logarithmic(low, high) : linear(low, high);
  const [first, last] = range(lines.map((l) => l.x), false);
  ready.x = { ...linear(first, last, 6), low: first, high: last > first ? last : first + 1 };
  return ready;
}

export function draw(context, panel, width, height, colours, style, cursor) {
  const area = {
    left: MARGIN.left, top: MARGIN.top,
    width: width - MARGIN.left - MARGIN.right, height: height - MARGIN.top - MARGIN.bottom,
  };
  const X = (x) => area.left + place(panel.x, x) * area.width;
  const Y = (y) => area.top + (1 - place(panel.y, y)) * area.height;
  frame(context, panel, area, X, Y, colours);
  context.save();
  context.beginPath();
  context.rect(area.left, area.top, area.width, area.height);
  context.clip();
  if (panel.bands) for (const [name, band] of Object.entries(panel.bands.of)) {
    // Fainter while it is that of the settings before.
    const strength = panel.bands.old ? 0.4 : 1;
    const { colour } = style(name);
    ribbon(context, panel.bands.t, band.low, band.high, X, Y, panel, colour, strength);
    stroke(context, panel.bands.t, band.middle, X, Y, panel, colour, 1, [2, 2], 0.8 * strength);
  }
  for (const line of panel.lines) {
    if (line.low) ribbon(context, line.x, line.low, line.high, X, Y, panel, style(line.observer).colour);
  }
  // The truth lies under what is to be compared with it.
  const ordered = [...panel.lines].sort((a, b) => (a.observer === null ? 0 : 1) - (b.observer === null ? 0 : 1));
  for (const line of ordered) {
    if (line.observer === null) {
      stroke(context, line.x, line.values, X, Y, panel, colours.truth, 3.2, [], 0.35);
    } else if (line.dots) {
      dots(context, line.x, line.values, X, Y, style(line.observer).colour);
    } else {
      const { colour, dash } = style(line.observer);
      stroke(context, line.x, line.values, X, Y, panel, colour, 1.6, dash, 1);
    }
  }
  panel.lines.forEach((line, k) => {
    if (line.coasting) strip(context, line, X, area, k, style(line.observer).colour);
  });
  if (cursor !== null && cursor !== undefined) {
    context.globalAlpha = 0.7;
    context.strokeStyle = colours.ink;
    context.lineWidth = 1;
    context.setLineDash([]);
    context.beginPath();
    context.moveTo(X(cursor), area.top);
    context.lineTo(X(cursor), area.top + area.height);
    context.stroke();
  }
  context.restore();
  return area;
}

function frame(context, panel, area, X, Y, colours) {
  context.setLineDash([]);
  context.lineWidth = 1;
  context.font = `11px ${FONT}`;
  context.fillStyle = colours.soft;
  context.textBaseline = "middle";
  context.textAlign = "right";
  for (const tick of panel.y.ticks) {
    const y = Math.round(Y(tick.value)) + 0.5;
    context.strokeStyle = colours.grid;
    context.globalAlpha = tick.minor ? 0.5 : 1;
    segment(context, area.left, y, area.left + area.width, y);
    context.globalAlpha = 1;
    if (tick.text) context.fillText(tick.text, area.left - 6, y);
  }
  context.textBaseline = "top";
  context.textAlign = "center";
  for (const tick of panel.x.ticks) {
    if (tick.value < panel.x.low - 1e-9 || tick.value > panel.x.high + 1e-9) continue;
    const x = Math.round(X(tick.value)) + 0.5;
    context.strokeStyle = colours.grid;
    segment(context, x, area.top, x, area.top + area.height);
    context.fillText(tick.text, x, area.top + area.height + 5);
  }
  context.textAlign = "right";
  context.fillText(panel.about ?? "t (s)", area.left + area.width, area.top + area.height + 19);
  context.strokeStyle = colours.soft;
  context.beginPath();
  context.rect(area.left + 0.5, area.top + 0.5, area.width, area.height);
  context.stroke();
}

function segment(context, x0, y0, x1, y1) {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}

const seen = (y, log) => Number.isFinite(y) && Math.abs(y) < 1e30 && !(log && y <= 0);

function stroke(context, x, y, X, Y, panel, colour, width, dash, alpha) {
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.globalAlpha = alpha;
  context.lineJoin = "round";
  context.setLineDash(dash);
  context.beginPath();
  let down = false;
  for (let k = 0; k < y.length; k++) {
    const there = seen(y[k], panel.log);
    if (there && down && !(panel.wraps && Math.abs(y[k] - y[k - 1]) > Math.PI)) context.lineTo(X(x[k]), Y(y[k]));
    else if (there) context.moveTo(X(x[k]), Y(y[k]));
    down = there;
  }
  context.stroke();
  context.setLineDash([]);
  context.globalAlpha = 1;
}

function ribbon(context, x, low, high, X, Y, panel, colour, strength = 1) {
  const bound = (y) => (seen(y, panel.log) ? y : y > 0 ? panel.y.high : panel.y.low);
  context.fillStyle = colour;
  context.globalAlpha = 0.16 * strength;
  context.beginPath();
  for (let k = 0; k < x.length; k++) {
    const [px, py] = [X(x[k]), Y(bound(high[k]))];
    if (k) context.lineTo(px, py); else context.moveTo(px, py);
  }
  for (let k = x.length - 1; k >= 0; k--) context.lineTo(X(x[k]), Y(bound(low[k])));
  context.closePath();
  context.fill();
  context.globalAlpha = 1;
}

function dots(context, x, y, X, Y, colour) {
  context.fillStyle = colour;
  context.globalAlpha = 0.5;
  context.beginPath();
  for (let k = 0; k < y.length; k++) {
    if (seen(y[k], true)) context.rect(X(x[k]) - 1.5, Y(y[k]) - 1.5, 3, 3);
  }
  context.fill();
  context.globalAlpha = 1;
}

// Where an observer coasts: a bar at the bottom.
function strip(context, line, X, area, k, colour) {
  context.fillStyle = colour;
  context.globalAlpha = 0.9;
  const y = area.top + area.height - 5 * (k + 1);
  const { x, coasting } = line;
  for (let first = 0; first < coasting.length; first++) {
    if (!coasting[first]) continue;
    let last = first;
    while (last + 1 < coasting.length && coasting[last + 1]) last++;
    const end = Math.min(last + 1, x.length - 1);
    context.fillRect(X(x[first]), y, Math.max(1, X(x[end]) - X(x[first])), 3);
    first = last;
  }
  context.globalAlpha = 1;
}

// The values of a panel at an instant, in words.
export function readout(panel, at) {
  return panel.lines.filter((line) => !line.dots).map((line) => {
    const k = nearest(line.x, at);
    return `${line.observer ?? "truth"} ${shown(line.values[k])}`;
  }).join("  ·  ");
}

export function nearest(x, at) {
  let low = 0, high = x.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (x[middle] < at) low = middle; else high = middle;
  }
  return at - x[low] < x[high] - at ? low : high;
}

// What a panel shows, for those who do not see it.
export function described(panel) {
  const parts = panel.lines.map((line) => {
    if (!line.values.some(Number.isFinite)) return `${line.observer ?? "truth"}: not known`;
    const [low, high] = range([line.values], false);
    const end = line.values[line.values.length - 1];
    return `${line.observer ?? "truth"}: from ${shown(low)} to ${shown(high)}, at the end ${shown(end)}`;
  });
  const unit = panel.unit && panel.unit !== "1" ? ` in ${panel.unit}` : "";
  return `${panel.title}${unit}, ${parts.join("; ")}. Arrow keys move a cursor.`;
}
