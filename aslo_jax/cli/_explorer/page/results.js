// The results of a study: a table of its metrics, and what can be asked of them.

import { shown } from "./axes.js";
import { made, swatch } from "./controls.js";

export function table(root, run, style, open) {
  const metrics = Object.keys(run.table[0] ?? {}).filter((key) => key !== "observer");
  const heads = ["observer", ...metrics.flatMap((m) => [`${m.replaceAll("_", " ")}, median`, "worst sample"])];
  const rows = run.table.map((row) => {
    const { colour, dash } = style(row.observer);
    const cells = metrics.flatMap((metric) => {
      const button = made("button", { type: "button" }, String(row[metric].worst));
      button.setAttribute("aria-label", `Open sample ${row[metric].worst}, the worst ${metric} of ${row.observer}`);
      button.addEventListener("click", () => open(row[metric].worst));
      return [made("td", {}, shown(row[metric].median)), made("td", {}, button)];
    });
    return made("tr", {}, made("th", { scope: "row" }, swatch(colour, dash), ` ${row.observer}`), ...cells);
  });
  const caption = made("caption", {}, `${run.samples} samples`);
  const head = made("thead", {}, made("tr", {}, ...heads.map((h) => made("th", { scope: "col" }, h))));
  root.replaceChildren(made("table", {}, caption, head, made("tbody", {}, ...rows)));
}

export function controls(root, run, { against, openSample }) {
  if (root.dataset.samples === String(run.samples)) return;
  root.dataset.samples = String(run.samples);
  const select = made("select", { id: "parameter" }, ...run.parameters.map((p) => made("option", { value: p }, p.replaceAll("_", " "))));
  select.addEventListener("change", () => against(select.value));
  const index = made("input", { id: "sample", type: "number", min: "0", max: String(run.samples - 1), value: "0" });
  const open = made("button", { type: "button", id: "open-sample" }, "Simulate this sample");
  open.addEventListener("click", () => index.checkValidity() && index.value !== "" && openSample(index.value));
  root.replaceChildren(
    made("div", { class: "field" }, made("label", { for: "parameter" }, "Parameter of the scatter"), select),
    made("div", { class: "field" }, made("label", { for: "sample" }, "Sample"), index),
    open,
  );
}
