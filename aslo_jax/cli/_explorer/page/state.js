// The state of the page, which is that of its address.

const PLAIN = ["source", "observer", "horizon", "seed", "tolerance"];

export function read(query) {
  const given = new URLSearchParams(query);
  const values = {};
  for (const [key, value] of given) {
    if (key.includes(".")) values[key] = numeric(value);
  }
  return {
    source: given.get("source") ?? "",
    observers: given.getAll("observer"),
    horizon: given.get("horizon") ?? "",
    seed: given.get("seed") ?? "0",
    tolerance: given.get("tolerance") ?? "1",
    values,
  };
}

export function written(state) {
  const query = new URLSearchParams();
  if (state.source) query.set("source", state.source);
  for (const name of state.observers) query.append("observer", name);
  if (state.horizon !== "") query.set("horizon", state.horizon);
  if (Number(state.seed) !== 0) query.set("seed", state.seed);
  if (Number(state.tolerance) !== 1) query.set("tolerance", state.tolerance);
  for (const [key, value] of Object.entries(state.values)) query.set(key, value);
  return query.toString().replaceAll("+", "%20");
}

// What does not belong to the observers or the source that are shown any more.
export function pruned(state, knobs) {
  const known = new Set(knobs.map((knob) => knob.key));
  const kept = Object.entries(state.values).filter(([key]) => known.has(key));
  return { ...state, values: Object.fromEntries(kept) };
}

export const isPlain = (key) => PLAIN.includes(key);

function numeric(text) {
  const number = Number(text);
  return text.trim() !== "" && Number.isFinite(number) ? number : text;
}
