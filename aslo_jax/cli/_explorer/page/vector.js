// The part of a canvas's context that plots use, as SVG text.

const escaped = (text) =>
  text.replace(/[&<>"]/g, (c) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[c]);
const short = (x) => String(Number(x.toFixed(2)));

export class VectorContext {
  constructor(width, height) {
    Object.assign(this, { width, height, parts: [], path: "", dash: [], saved: [], shift: [0, 0] });
    Object.assign(this, { fillStyle: "#000", strokeStyle: "#000", lineWidth: 1, globalAlpha: 1 });
    Object.assign(this, { font: "12px sans-serif", textAlign: "left", textBaseline: "alphabetic", lineJoin: "round" });
    this.clips = 0;
  }
  at(x, y) { return `${short(x + this.shift[0])} ${short(y + this.shift[1])}`; }
  beginPath() { this.path = ""; }
  moveTo(x, y) { this.path += `M${this.at(x, y)}`; }
  lineTo(x, y) { this.path += `L${this.at(x, y)}`; }
  closePath() { this.path += "Z"; }
  rect(x, y, w, h) {
    this.moveTo(x, y); this.lineTo(x + w, y); this.lineTo(x + w, y + h); this.lineTo(x, y + h); this.closePath();
  }
  setLineDash(dash) { this.dash = dash; }
  translate(x, y) { this.shift = [this.shift[0] + x, this.shift[1] + y]; }
  save() {
    const { fillStyle, strokeStyle, lineWidth, globalAlpha, font, textAlign, textBaseline, dash, shift } = this;
    this.saved.push({ fillStyle, strokeStyle, lineWidth, globalAlpha, font, textAlign, textBaseline, dash, shift, clipped: false });
  }
  restore() {
    const { clipped, ...before } = this.saved.pop();
    if (clipped) this.parts.push("</g>");
    Object.assign(this, before);
  }
  clip() {
    const id = `clip${this.clips++}`;
    this.parts.push(`<clipPath id="${id}"><path d="${this.path}"/></clipPath><g clip-path="url(#${id})">`);
    this.saved.at(-1).clipped = true;
  }
  stroke() {
    const dash = this.dash.length ? ` stroke-dasharray="${this.dash.join(" ")}"` : "";
    this.parts.push(`<path d="${this.path}" fill="none" stroke="${this.strokeStyle}" stroke-width="${this.lineWidth}" stroke-linejoin="round" opacity="${this.globalAlpha}"${dash}/>`);
  }
  fill() {
    this.parts.push(`<path d="${this.path}" fill="${this.fillStyle}" opacity="${this.globalAlpha}"/>`);
  }
  fillRect(x, y, w, h) { this.beginPath(); this.rect(x, y, w, h); this.fill(); }
  fillText(text, x, y) {
    const [, weight, size] = /^(\d+ )?(\d+)px/.exec(this.font) ?? [null, "", "12"];
    const anchor = { left: "start", center: "middle", right: "end" }[this.textAlign];
    const down = { alphabetic: 0, middle: 0.35, top: 0.8 }[this.textBaseline] * Number(size);
    const [px, py] = this.at(x, y + down).split(" ");
    this.parts.push(`<text x="${px}" y="${py}" font-size="${size}" font-weight="${(weight || "400").trim()}" text-anchor="${anchor}" fill="${this.fillStyle}">${escaped(text)}</text>`);
  }
  measureText(text) { return { width: 0.58 * Number(/(\d+)px/.exec(this.font)[1]) * text.length }; }
  text() {
    return `<svg xmlns="http://www.w3.org/2000/svg" width="${this.width}" height="${this.height}" viewBox="0 0 ${this.width} ${this.height}" font-family="system-ui, DejaVu Sans, sans-serif">\n${this.parts.join("\n")}\n</svg>\n`;
  }
}
