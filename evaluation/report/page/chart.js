// The plots: values and intervals under the pointer or the arrow keys, lines switched on and off.

(() => {
  "use strict";

  const SVG = "http://www.w3.org/2000/svg";
  const minus = (text) => text.replace("-", "\u2212");
  const plain = (value) => (value !== 0 && (Math.abs(value) >= 999.5 || Math.abs(value) < 1e-3) ? String(Number(value.toPrecision(3))) : value.toPrecision(3));
  const number = (value) => minus(plain(value));
  const made = (kind, parent, name = "", text = "") => {
    const element = parent.appendChild(document.createElement(kind));
    if (name) element.className = name;
    element.textContent = text;
    return element;
  };

  // Where a value lies between the ends of an axis, from 0 to 1.
  function share(value, { ends, log }) {
    const [low, high, here] = log ? [...ends, value].map(Math.log10) : [...ends, value];
    return (here - low) / (high - low);
  }

  const across = ({ box, x }, value) => box[0] + box[2] * share(value, x);
  const down = ({ box, y }, value) => box[1] + box[3] * (1 - share(value, y));

  class Plot {
    // `holder` is the element around one drawing, `frames` say where its axes lie.
    constructor(figure, panel, holder, story, frames) {
      Object.assign(this, { figure, story, frames, axes: 0, place: 0 });
      this.svg = holder.querySelector("svg");
      this.marks = this.svg.appendChild(document.createElementNS(SVG, "g"));
      this.marks.setAttribute("class", "marks");
      this.tip = made("div", panel, "tip");
      this.tip.hidden = true;
      holder.classList.add("read");
      holder.tabIndex = 0;
      holder.setAttribute("role", "slider");
      holder.setAttribute("aria-label", `Values of: ${this.svg.getAttribute("aria-label")}`);
      this.holder = holder;
      this.tell();
      this.svg.addEventListener("pointermove", (event) => this.point(event));
      this.svg.addEventListener("pointerdown", (event) => this.point(event));
      this.svg.addEventListener("pointerleave", (event) => event.pointerType === "mouse" && this.clear());
      document.addEventListener("pointerdown", (event) => holder.contains(event.target) || this.clear());
      holder.addEventListener("focus", () => holder.matches(":focus-visible") && this.show());
      holder.addEventListener("blur", () => this.clear());
      holder.addEventListener("keydown", (event) => this.step(event));
    }

    // Every place at which something is drawn, in order.
    places() {
      const known = this.story.axes[this.axes].series.filter((series) => this.on(series));
      return [...new Set(known.flatMap((series) => series.at))].filter((at) => at !== null).sort((a, b) => a - b);
    }

    on(series) {
      return !this.figure.off.has(this.story.names[series.n]);
    }

    point(event) {
      const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(this.svg.getScreenCTM().inverse());
      const gap = ({ box }) => Math.max(0, box[1] - y, y - box[1] - box[3]) + Math.max(0, box[0] - x, x - box[0] - box[2]);
      const nearest = this.frames.map(gap);
      this.axes = nearest.indexOf(Math.min(...nearest));
      const { sideways } = this.story.axes[this.axes], frame = this.frames[this.axes];
      const away = this.places().map((at) => Math.abs(sideways ? down(frame, at) - y : across(frame, at) - x));
      if (!away.length) return this.clear();
      this.place = away.indexOf(Math.min(...away));
      this.show(sideways ? x : y);
    }

    step(event) {
      const places = this.places(), { sideways } = this.story.axes[this.axes], far = Math.max(1, Math.round(places.length / 10));
      const moves = { ArrowRight: 1, ArrowLeft: -1, PageUp: far, PageDown: -far, Home: -Infinity, End: Infinity };
      if (sideways) Object.assign(moves, { ArrowDown: 1, ArrowUp: -1 });
      if (event.key === "Escape") this.clear();
      else if (event.key in moves) this.place = Math.min(places.length - 1, Math.max(0, this.place + moves[event.key]));
      else if (event.key === "ArrowDown") this.axes = Math.min(this.frames.length - 1, this.axes + 1);
      else if (event.key === "ArrowUp") this.axes = Math.max(0, this.axes - 1);
      else return;
      event.preventDefault();
      if (event.key !== "Escape") this.show();
    }

    // What is drawn at the place: the name, the value and the interval of each series.
    read() {
      const axes = this.story.axes[this.axes], at = this.places()[this.place];
      const found = [];
      for (const series of axes.series) {
        const i = this.on(series) ? series.at.indexOf(at) : -1;
        if (i < 0 || series.value[i] === null) continue;
        const known = series.low && series.low[i] !== null && series.high[i] !== null && series.low[i] !== series.high[i];
        found.push({ n: series.n, name: this.story.names[series.n], at, value: series.value[i], interval: known ? [series.low[i], series.high[i]] : null });
      }
      return { head: axes.sideways ? axes.rows[Math.round(at)] : `${axes.place.replace(/ \((.*)\)$/, "")} ${at === undefined ? "" : minus(String(at))} ${/\((.*)\)$/.exec(axes.place)?.[1] ?? ""}`.trim(), value: axes.value, found };
    }

    show(near = null) {
      const { head, value, found } = this.read(), frame = this.frames[this.axes], { sideways } = this.story.axes[this.axes];
      this.tell();
      this.marks.replaceChildren();
      this.tip.replaceChildren();
      this.tip.hidden = !found.length;
      if (!found.length) return;
      const spot = (one) => (sideways ? [across(frame, one.value), down(frame, one.at)] : [across(frame, one.at), down(frame, one.value)]);
      const [left, top, width, height] = frame.box, [x, y] = spot(found[0]);
      const line = this.marks.appendChild(document.createElementNS(SVG, "path"));
      line.setAttribute("d", sideways ? `M${left} ${y}H${left + width}` : `M${x} ${top}V${top + height}`);
      const away = found.map((one) => (near === null ? Infinity : Math.abs(spot(one)[sideways ? 0 : 1] - near)));
      const closest = Math.min(...away);
      const order = found.map((one, i) => [one, away[i] === closest && closest < 12]).sort(([a], [b]) => b.value - a.value);
      made("p", this.tip, "place", head);
      const table = made("table", this.tip);
      for (const [one, chosen] of order) {
        const key = this.figure.keys.get(one.name), row = made("tr", table, chosen ? "chosen" : "");
        made("td", row).style.setProperty("--key", key);
        made("td", row, "", one.name);
        made("td", row, "", number(one.value));
        made("td", row, "", one.interval ? `${number(one.interval[0])} to ${number(one.interval[1])}` : "");
        const [cx, cy] = spot(one);
        if (sideways || cx < left - 1 || cx > left + width + 1 || cy < top - 1 || cy > top + height + 1) continue;
        const dot = this.marks.appendChild(document.createElementNS(SVG, "circle"));
        for (const [name, text] of Object.entries({ cx, cy, r: chosen ? 4.5 : 3 })) dot.setAttribute(name, text);
        dot.style.fill = key;
      }
      made("p", this.tip, "place", value);
      this.stand(sideways ? y : x, sideways, left, top);
    }

    // The tip stands beside the line and inside the panel.
    stand(middle, sideways, left, top) {
      const matrix = this.svg.getScreenCTM(), panel = this.tip.parentElement.getBoundingClientRect();
      const at = new DOMPoint(sideways ? left : middle, sideways ? middle : top).matrixTransform(matrix);
      const wide = this.tip.offsetWidth, room = panel.width;
      const x = at.x - panel.left;
      const beside = sideways ? room - wide - 4 : x + 14 + wide < room ? x + 14 : x - 14 - wide;
      this.tip.style.left = `${Math.max(0, Math.min(room - wide, beside))}px`;
      this.tip.style.top = `${at.y - panel.top + (sideways ? 14 : 4)}px`;
    }

    tell() {
      const places = this.places(), { head, found } = this.read();
      this.place = Math.max(0, Math.min(this.place, places.length - 1));
      const words = found.map((one) => `${one.name} ${number(one.value)}${one.interval ? ` (${number(one.interval[0])} to ${number(one.interval[1])})` : ""}`);
      const aria = { valuemin: 0, valuemax: Math.max(0, places.length - 1), valuenow: this.place, valuetext: `${head}: ${words.join(", ")}` };
      for (const [name, text] of Object.entries(aria)) this.holder.setAttribute(`aria-${name}`, text);
    }

    clear() {
      this.tip.hidden = true;
      this.marks.replaceChildren();
    }

    change() {
      for (const series of this.svg.querySelectorAll("[data-series]")) {
        series.classList.toggle("off", this.figure.off.has(this.story.names[series.dataset.series]));
      }
      this.clear();
      this.tell();
    }
  }

  // Elements of a controller open its replay; the pointer shows the sentence on it.
  const played = new Set([...(document.querySelector("#replay-row")?.options ?? [])].map((option) => option.value));
  for (const data of document.querySelectorAll("script.links")) {
    const links = JSON.parse(data.textContent);
    for (const svg of data.parentElement.querySelectorAll("svg")) svg.setAttribute("role", "group"); // parts can have the focus
    for (const element of data.parentElement.querySelectorAll("[data-link]")) {
      const [row, sentence] = links[element.dataset.link];
      const title = element.insertBefore(document.createElementNS(SVG, "title"), element.firstChild);
      title.textContent = sentence;
      if (!played.has(row)) continue;
      const watch = () => document.dispatchEvent(new CustomEvent("watch", { detail: row }));
      element.classList.add("plays");
      element.addEventListener("click", watch);
      if (!element.querySelector("text")) continue;
      element.tabIndex = 0;
      element.setAttribute("role", "button");
      element.setAttribute("aria-label", `Watch ${sentence}`);
      element.addEventListener("keydown", (event) => event.key === "Enter" && watch());
    }
  }

  // One of several drawings of a figure is chosen by its title.
  for (const figure of document.querySelectorAll("figure[data-choose]")) {
    const panels = [...figure.querySelectorAll(".panel")];
    if (panels.length < 2) continue;
    const label = made("label", figure, "choice", `${figure.dataset.choose} `), select = made("select", label);
    for (const panel of panels) made("option", select, "", panel.dataset.title);
    select.addEventListener("change", () => panels.forEach((panel, i) => { panel.hidden = i !== select.selectedIndex; }));
    panels[0].parentElement.before(label);
  }

  // One figure: its legend switches the lines of every drawing in it.
  function prepare(element) {
    const figure = { off: new Set(), keys: new Map(), plots: [], buttons: new Map() };
    for (const entry of element.querySelectorAll(".legend li")) {
      const name = entry.dataset.name, button = document.createElement("button");
      button.type = "button";
      button.append(...entry.childNodes);
      entry.append(button);
      figure.buttons.set(name, button);
      figure.keys.set(name, entry.dataset.colour);
      if (entry.classList.contains("off")) figure.off.add(name);
      entry.classList.remove("off");
      button.setAttribute("aria-pressed", String(!figure.off.has(name)));
      button.addEventListener("click", () => switched(name, figure.off.has(name), element));
    }
    for (const data of element.querySelectorAll("script.chart")) {
      const story = JSON.parse(data.textContent), panel = data.parentElement;
      for (const [holder, frames] of [[panel.querySelector(".plot"), story.frames], [panel.querySelector(".on-narrow"), story.narrow]]) {
        if (holder && frames) figure.plots.push(new Plot(figure, panel, holder, story, frames));
      }
    }
    return { element, figure };
  }

  const figures = [...document.querySelectorAll("figure")].filter((one) => one.querySelector("script.chart")).map(prepare);

  // A model has the same name in every figure of its section, and is switched in all of them.
  function switched(name, on, origin) {
    const section = origin.closest("section");
    for (const { element, figure } of figures) {
      if (element.closest("section") !== section || !figure.buttons.has(name)) continue;
      if (on) figure.off.delete(name);
      else figure.off.add(name);
      figure.buttons.get(name).setAttribute("aria-pressed", String(on));
      for (const plot of figure.plots) plot.change();
    }
  }
})();
