// Every table as CSV and every figure as SVG, by a click.

(() => {
  "use strict";

  const SVG = "http://www.w3.org/2000/svg";

  function save(name, kind, text) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type: kind }));
    link.download = `${name.toLowerCase().replace(/[^a-z0-9]+/g, "-").replace(/^-|-$/g, "")}.${kind.includes("csv") ? "csv" : "svg"}`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  function offer(before, word, label, make) {
    const tools = document.createElement("div"), button = document.createElement("button");
    tools.className = "tools";
    button.type = "button";
    button.textContent = word;
    button.setAttribute("aria-label", label);
    button.addEventListener("click", make);
    tools.append(button);
    before.after(tools);
  }

  // The text of a cell, its lines joined; a command to copy is its text.
  function textOf(cell) {
    if (cell.dataset.command) return cell.dataset.command;
    const copy = cell.cloneNode(true);
    for (const other of copy.querySelectorAll(".help, [popover], td.copy button")) other.remove();
    for (const line of copy.querySelectorAll("br")) line.replaceWith(" ");
    return copy.textContent.trim();
  }

  const quoted = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  const csv = (table) => [...table.rows].map((row) => [...row.cells].map(textOf).map(quoted).join(",")).join("\r\n");

  for (const table of document.querySelectorAll("main table[data-name]")) {
    const { name } = table.dataset;
    offer(table.closest(".scroll"), "CSV", `Save as CSV: ${name}`, () => save(name, "text/csv", `\ufeff${csv(table)}\r\n`));
  }

  // A drawing as it is shown, in the colours of the light theme, with its legend below it.
  function svgOf(figure) {
    const shown = [...figure.querySelectorAll("svg[viewBox]")].find((svg) => !svg.closest(".legend") && svg.getClientRects().length);
    const svg = shown.cloneNode(true), [, , wide, high] = svg.getAttribute("viewBox").split(" ").map(Number);
    for (const gone of svg.querySelectorAll(".marks, .off")) gone.remove();
    let [x, y] = [8, high + 12];
    const add = (kind, values, text = "") => {
      const element = svg.appendChild(document.createElementNS(SVG, kind));
      for (const [name, value] of Object.entries(values)) element.setAttribute(name, value);
      element.textContent = text;
    };
    for (const entry of figure.querySelectorAll(".legend li")) {
      if (entry.querySelector('[aria-pressed="false"]')) continue;
      const { name, colour } = entry.dataset, long = 26 + 5.2 * name.length;
      if (x > 8 && x + long > wide) [x, y] = [8, y + 13];
      add("path", { d: `M${x} ${y - 3}h16`, stroke: colour, "stroke-width": 2 });
      add("text", { x: x + 20, y, "font-size": 9, fill: "var(--ink)" }, name);
      x += long + 8;
    }
    svg.setAttribute("viewBox", `0 0 ${wide} ${figure.querySelector(".legend") ? y + 6 : high}`);
    svg.setAttribute("xmlns", SVG);
    svg.setAttribute("font-family", "sans-serif");
    const colours = getComputedStyle(document.documentElement);
    return new XMLSerializer().serializeToString(svg).replace(/var\((--[a-z]+)\)/g, (_, name) => colours.getPropertyValue(name).trim());
  }

  for (const figure of document.querySelectorAll("figure[data-name]")) {
    const { name } = figure.dataset, caption = figure.querySelector("figcaption");
    offer(caption.previousElementSibling, "SVG", `Save as SVG: ${name}`, () => save(name, "image/svg+xml", svgOf(figure)));
  }
})();
