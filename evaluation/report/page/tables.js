// The tables: a button in every head sorts by its column, up, down and back; the second column stays in view;
// commands are copied.

(() => {
  "use strict";

  const NUMBER = /^[*=!<> ]*([+\u2212-]?\d+(?:\.\d+)?)/;

  // A cell is sorted by the number that it begins with, else by its text; "best" counts as 0.
  function key(cell) {
    const text = cell.textContent.trim(), found = NUMBER.exec(text);
    return { number: text === "best" ? 0 : found ? Number(found[1].replace("\u2212", "-")) : null, text };
  }

  function sort(table, column, order, original) {
    const rows = order === "none" ? original : [...original];
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
    const heads = [...table.tHead.rows[0].cells], original = [...table.tBodies[0].rows];
    heads.forEach((head, column) => {
      if (head.matches(".copy")) return;
      const button = document.createElement("button");
      button.type = "button";
      button.className = "sort";
      const help = [...head.querySelectorAll(".help, [popover]")];
      for (const one of help) one.remove(); // no button inside another
      button.append(...head.childNodes);
      head.append(button, ...help);
      button.addEventListener("click", () => {
        const before = head.getAttribute("aria-sort") ?? "none";
        const order = { none: "ascending", ascending: "descending", descending: "none" }[before];
        for (const other of heads) other.removeAttribute("aria-sort");
        if (order !== "none") head.setAttribute("aria-sort", order);
        sort(table, column, order, original);
      });
    });
  }

  // The second column is kept in view next to the first, whose width depends on its names.
  for (const table of document.querySelectorAll("table.two")) {
    const place = () => table.style.setProperty("--first", `${table.rows[0].cells[0].offsetWidth}px`);
    new ResizeObserver(place).observe(table);
    table.classList.add("fixed");
    place();
  }

  async function copy(text) {
    try {
      await navigator.clipboard.writeText(text);
    } catch { // without a clipboard the text is selected and copied
      const code = document.body.appendChild(document.createElement("pre"));
      code.textContent = text;
      getSelection().selectAllChildren(code);
      document.execCommand("copy");
      getSelection().removeAllRanges();
      code.remove();
    }
  }

  for (const command of document.querySelectorAll(".command, [data-command]")) {
    const button = command.appendChild(document.createElement("button"));
    button.type = "button";
    button.textContent = "Copy";
    button.title = command.dataset.command ?? "";
    button.setAttribute("aria-live", "polite");
    button.addEventListener("click", async () => {
      await copy(command.dataset.command ?? command.querySelector("code").textContent);
      button.textContent = "Copied";
      setTimeout(() => { button.textContent = "Copy"; }, 2000);
    });
  }
})();
