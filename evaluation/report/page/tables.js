// The tables: a button in every head sorts by its column, up, down and back; commands are copied.

(() => {
  "use strict";

  const NUMBER = /^[*=!<> ]*([+\u2212-]?\d+(?:\.\d+)?)/;

  // What a cell is sorted by: the number that it begins with, else its text. "best" is none above the best.
  function key(cell) {
    const text = cell.textContent.trim(), found = NUMBER.exec(text);
    return { number: text === "best" ? 0 : found ? Number(found[1].replace("\u2212", "-")) : null, text };
  }

  function sort(table, column, order, asItWas) {
    const rows = order === "none" ? asItWas : [...asItWas];
    if (order !== "none") {
      const keys = new Map(rows.map((row) => [row, key(row.cells[column])]));
      const numbers = rows.filter((row) => keys.get(row).number !== null).length >= rows.length / 2;
      const sign = order === "ascending" ? 1 : -1;
      rows.sort((one, two) => {
        const [a, b] = [keys.get(one), keys.get(two)];
        if (!numbers) return sign * a.text.localeCompare(b.text);
        if (a.number === null || b.number === null) return (a.number === null) - (b.number === null); // last, always
        return sign * (a.number - b.number);
      });
    }
    table.tBodies[0].append(...rows);
  }

  for (const table of document.querySelectorAll("table.sorts")) {
    const heads = [...table.tHead.rows[0].cells], asItWas = [...table.tBodies[0].rows];
    heads.forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const before = head.getAttribute("aria-sort") ?? "none";
        const order = { none: "ascending", ascending: "descending", descending: "none" }[before];
        for (const other of heads) other.removeAttribute("aria-sort");
        if (order !== "none") head.setAttribute("aria-sort", order);
        sort(table, column, order, asItWas);
      });
    });
  }

  async function copy(code) {
    try {
      await navigator.clipboard.writeText(code.textContent);
    } catch { // no clipboard in this place: as if copied by hand
      getSelection().selectAllChildren(code);
      document.execCommand("copy");
      getSelection().removeAllRanges();
    }
  }

  for (const command of document.querySelectorAll(".command")) {
    const button = command.appendChild(document.createElement("button"));
    button.type = "button";
    button.textContent = "Copy";
    button.setAttribute("aria-live", "polite");
    button.addEventListener("click", async () => {
      await copy(command.querySelector("code"));
      button.textContent = "Copied";
      setTimeout(() => { button.textContent = "Copy"; }, 2000);
    });
  }
})();
