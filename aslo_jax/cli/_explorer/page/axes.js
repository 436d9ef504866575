// Scales, ticks and numbers of axes.

const SUPERSCRIPTS = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };

// A number for a person: four digits.
export function shown(x) {
  if (x === null || x === undefined || Number.isNaN(x)) return "–";
  if (!Number.isFinite(x)) return x > 0 ? "∞" : "−∞";
  if (x === 0) return "0";
  const size = Math.abs(x);
  const text = size >= 1e5 || size < 1e-3 ? String(Number(x.toPrecision(4)).toExponential()) : String(Number(x.toPrecision(4)));
  return text.replace("e+", "e").replace("-", "−").replace("e-", "e−");
}

export function power(exponent) {
  return "10" + [...String(exponent)].map((c) => SUPERSCRIPTS[c]).join("");
}

export function linear(low, high, count = 5) {
  if (!(high > low)) [low, high] = [low - (Math.abs(low) || 1) * 0.5, low + (Math.abs(low) || 1) * 0.5];
  const rough = (high - low) / count;
  const unit = 10 ** Math.floor(Math.log10(rough));
  const step = unit * [1, 2, 2.5, 5, 10].find((m) => m * unit >= rough * 0.999);
  const first = Math.floor(low / step + 1e-9), last = Math.ceil(high / step - 1e-9);
  const ticks = [];
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9) + (String(step / unit).includes(".") ? 1 : 0));
  const far = Math.max(Math.abs(first), Math.abs(last)) * step;
  for (let k = first; k <= last; k++) {
    const value = k * step;
    const text = far >= 1e5 || step < 1e-4 ? shown(value) : value.toFixed(Math.min(digits, 8)).replace("-", "−");
    ticks.push({ value, text: Number(value.toFixed(12)) === 0 ? "0" : text });
  }
  return { low: first * step, high: last * step, ticks, log: false };
}

export function logarithmic(low, high) {
  let first = Math.floor(Math.log10(low) + 1e-9), last = Math.ceil(Math.log10(high) - 1e-9);
  if (last <= first) last = first + 1;
  const every = Math.max(1, Math.ceil((last - first) / 6));
  const ticks = [];
  for (let k = first; k <= last; k++) {
    ticks.push({ value: 10 ** k, text: (k - first) % every ? "" : power(k) });
    if (k < last && last - first <= 4) {
      for (let m = 2; m < 10; m++) ticks.push({ value: m * 10 ** k, text: "", minor: true });
    }
  }
  return { low: 10 ** first, high: 10 ** last, ticks, log: true };
}

// Where a value is along an axis, from 0 to 1.
export function place(axis, value) {
  if (!axis.log) return (value - axis.low) / (axis.high - axis.low);
  return Math.log(Math.max(value, 1e-300) / axis.low) / Math.log(axis.high / axis.low);
}

// The range of what is drawn but for its outermost 2 %, such as the transient of a start,
// and at most a few times that of the truth where there is any.
export function usual(arrays, truth) {
  const every = arrays.flatMap((values) => [...values]).filter((x) => Number.isFinite(x)).sort((a, b) => a - b);
  if (!every.length) return [0, 1];
  let [low, high] = [every[Math.floor(0.02 * (every.length - 1))], every[Math.ceil(0.98 * (every.length - 1))]];
  if (!truth) {
    const room = 0.08 * (high - low);
    return [Math.max(every[0], low - room), Math.min(every.at(-1), high + room)];
  }
  const [least, most] = range([truth], false);
  const room = Math.max(0.6 * (most - least), 0.05 * Math.max(Math.abs(least), Math.abs(most)));
  return [Math.min(least, Math.max(low, least - room)), Math.max(most, Math.min(high, most + room))];
}

// The range of what is drawn; of logarithms that of what is above a thousandth of a percent
// of the largest value.
export function range(arrays, log) {
  let low = Infinity, high = -Infinity;
  for (const values of arrays) {
    for (const x of values) {
      if (!Number.isFinite(x) || Math.abs(x) > 1e30 || (log && x <= 0)) continue;
      if (x < low) low = x;
      if (x > high) high = x;
    }
  }
  if (low > high) return log ? [0.1, 1] : [0, 1];
  if (log) low = Math.max(low, high * 1e-5);
  return [low, high];
}
