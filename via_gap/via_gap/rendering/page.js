// Values under the pointer: every curve's path is read back through its panel's scales.
"use strict";
(() => {
  const readout = document.getElementById("readout");
  const parsed = new WeakMap();
  const points = (path) => {
    if (!parsed.has(path)) {
      const found = (path.getAttribute("d").match(/[ML][^ML]+/g) || []).map((part) => part.slice(1).split(" ").map(Number));
      parsed.set(path, found);
    }
    return parsed.get(path);
  };
  const show = (value) => Number(value.toPrecision(3)).toString();
  const over = (event) => {
    const svg = event.currentTarget;
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    const panel = [...svg.querySelectorAll("g.panel")].find((g) => at.y >= +g.dataset.top && at.y <= +g.dataset.base);
    if (!panel) { readout.style.display = "none"; return; }
    const [x0, x1] = panel.dataset.x.split(" ").map(Number);
    const [y0, y1] = panel.dataset.y.split(" ").map(Number);
    const lines = [];
    for (const path of panel.querySelectorAll("path.curve")) {
      const near = points(path).reduce((best, p) => (Math.abs(p[0] - at.x) < Math.abs(best[0] - at.x) ? p : best), [1e9, 0]);
      if (near[0] > 1e8) continue;
      if (!lines.length) lines.push(`${svg.dataset.xName}: ${show(x0 + x1 * near[0])} ${svg.dataset.xUnit}`);
      const level = y0 + y1 * near[1];
      const value = "log" in panel.dataset ? Math.pow(10, level) : level;
      lines.push(`${path.dataset.name}: ${show(value)} ${panel.dataset.yUnit}`);
    }
    readout.textContent = lines.join("\n");
    readout.style.display = lines.length ? "block" : "none";
    const left = Math.min(event.clientX + 14, document.documentElement.clientWidth - readout.offsetWidth - 6);
    readout.style.left = `${Math.max(left, 4)}px`;
    readout.style.top = `${Math.max(event.clientY - readout.offsetHeight - 12, 4)}px`;
  };
  for (const svg of document.querySelectorAll("svg.chart")) {
    svg.addEventListener("pointermove", over);
    svg.addEventListener("pointerleave", () => { readout.style.display = "none"; });
  }
  window.addEventListener("beforeprint", () => { for (const each of document.querySelectorAll("details")) each.open = true; });
})();
