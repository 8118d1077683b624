// The replay: one trial of a controller on the robot and in its models, on request on every system, at one time.

(() => {
  "use strict";

  const data = document.getElementById("replay-data");
  if (!data) return; // nothing to replay
  const story = JSON.parse(data.textContent);
  const player = document.getElementById("replay-player");
  const screens = player.querySelector(".screens");
  const [row, play, pace, slider, beside] = ["row", "play", "pace", "time", "beside"].map((name) => document.getElementById(`replay-${name}`));
  const [clock, all] = ["clock", "all"].map((name) => document.getElementById(`replay-${name}`));
  const FEW = 4, STRIP = 84, DIAL = 64, BAR = 16, FONT = "11px system-ui, sans-serif"; // px

  let shown = []; // screens of the controller that is chosen
  let time = 0; // s
  let playing = false;
  let before = null; // ms, the last frame

  const minus = (text) => text.replace("-", "\u2212");
  const number = (value) => minus(String(Number(value.toPrecision(3))));
  // With as many decimals as give the largest size of the channel three digits; nothing is minus zero.
  const inRange = (value, size) => minus(String(Number(value.toFixed(Math.min(9, Math.max(0, 2 - Math.floor(Math.log10(size || 1))))) + 0)));

  // Rows of numbers, kept as 16 bit steps above the lowest of each column.
  function unpacked({ low, step, data }) {
    const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0)), width = low.length;
    const steps = new DataView(bytes.buffer), row = (i) => (_, k) => {
      const count = steps.getUint16(2 * (i * width + k), true);
      return count === 65535 ? NaN : low[k] + count * step[k];
    };
    return Array.from({ length: bytes.length / 2 / width }, (_, i) => Array.from({ length: width }, row(i)));
  }

  function opened(run) {
    const targets = run.targets.map((target) => ({ ...target, values: unpacked(target.values).map((value) => value[0]) }));
    const [states, pose, side] = [run.states, run.pose, run.side].map((numbers) => numbers && unpacked(numbers));
    return { ...run, states, pose, side, controls: unpacked(run.controls), last: (pose ?? states).length - 1, targets };
  }

  const element = (kind, parent, text = "") => {
    const made = parent.appendChild(document.createElement(kind));
    made.textContent = text;
    return made;
  };

  function summary(run) {
    const parts = run.own ? ["evolved here"] : [];
    if (run.fitness !== null) parts.push(`${number(run.fitness)} ${story.unit}`.trim());
    if (run.compared) parts.push(run.apart === null ? "matches the robot to the end" : `matches the robot for ${run.apart.toFixed(1)} s`);
    return parts.join("; ");
  }

  function choose(name) {
    const runs = story.runs.filter((run) => run.row === name).map(opened);
    const robot = runs.find((run) => run.robot) ?? null;
    screens.replaceChildren();
    const view = story.paths ? plane(robot ?? runs[0]) : null, beneath = view && fromSide(robot ?? runs[0]);
    const side = beneath && plane(beneath);
    const first = runs.filter((run) => run.robot || run.own), few = new Set((first.length > 1 ? first : runs).slice(0, FEW));
    all.hidden = few.size === runs.length;
    shown = runs.map((run) => {
      const figure = element("div", screens);
      figure.className = run.robot ? "screen robot" : few.has(run) ? "screen" : "screen other";
      const title = element("p", figure, run.column);
      title.className = "name";
      element("small", title, summary(run));
      const canvas = element("canvas", figure);
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", `${run.row} on ${run.column}: ${summary(run)}`);
      const now = element("p", figure);
      now.className = "now";
      if (run.apart !== null) {
        const there = element("button", figure, "Jump to divergence");
        there.type = "button";
        there.setAttribute("aria-label", `Jump to divergence of ${run.column} and the robot`);
        there.addEventListener("click", () => { start(false); seek(run.apart); });
      }
      return { run, figure, canvas, now, robot: run.robot ? null : robot, view, side };
    });
    // on a narrow page two screens are shown: the first, and the one that is chosen
    const names = runs.slice(1).map((run) => run.column), last = beside.value;
    beside.replaceChildren();
    for (const one of names) element("option", beside, one);
    beside.value = names.includes(last) ? last : names[0] ?? "";
    beside.parentElement.hidden = names.length < 2;
    pair();
    slider.max = Math.max(...runs.map((run) => run.last * run.dt));
    slider.step = Math.min(...runs.map((run) => run.dt));
    seek(Math.min(time, Number(slider.max)));
  }

  function pair() {
    shown.forEach((screen, i) => screen.figure.classList.toggle("paired", i === 0 || screen.run.column === beside.value));
    for (const screen of shown) draw(screen);
  }

  function frames(count) {
    start(false);
    const dt = Number(slider.step);
    seek(Math.min(Number(slider.max), Math.max(0, (Math.round(time / dt) + count) * dt)));
  }

  // A body in space as seen from the side, east to the right and up at the top; null for one on a plane.
  const across = ([x, , z]) => [x, z];
  const fromSide = (run) => run?.side ? { ...run, pose: run.side, markers: run.markers.map(across), walls: run.walls.map((wall) => wall.map(across)) } : null;

  // The part of the plane in every screen: path, places and walls of one trial.
  function plane(reference) {
    const points = [...reference.pose, ...reference.markers, ...reference.walls.flat()];
    const [xs, ys] = [points.map((point) => point[0]), points.map((point) => point[1])];
    const [left, right, low, high] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    const half = Math.max(0.05, (right - left) / 2, (high - low) / 2) * 1.08 + reference.radius;
    return { centre: [(left + right) / 2, (low + high) / 2], half };
  }

  function seek(seconds) {
    time = seconds;
    slider.value = seconds;
    clock.textContent = `${seconds.toFixed(1)} s`;
    slider.setAttribute("aria-valuetext", clock.textContent);
    for (const screen of shown) draw(screen);
  }

  function start(on) {
    if (on && time >= Number(slider.max)) seek(0);
    playing = on;
    before = null;
    play.textContent = on ? "Pause" : "Play";
    if (on) requestAnimationFrame(frame);
  }

  function frame(now) {
    if (!playing) return;
    if (before !== null) seek(Math.min(Number(slider.max), time + ((now - before) / 1000) * Number(pace.value)));
    before = now;
    if (time >= Number(slider.max)) start(false);
    else requestAnimationFrame(frame);
  }

  function draw(screen) {
    const { run, canvas, now } = screen, wide = canvas.clientWidth;
    if (!wide) return;
    const bars = story.controls.length * BAR + 4;
    const high = (story.paths ? (screen.side ? 2 : 1) * wide : story.shown.length * STRIP) + bars;
    const ratio = window.devicePixelRatio || 1;
    canvas.style.height = `${high}px`;
    if (canvas.width !== Math.round(wide * ratio) || canvas.height !== Math.round(high * ratio)) {
      canvas.width = Math.round(wide * ratio);
      canvas.height = Math.round(high * ratio);
    }
    const pen = canvas.getContext("2d");
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(`--${name}`).trim();
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, wide, high);
    pen.font = FONT;
    const step = Math.min(run.last, Math.round(time / run.dt));
    const over = time > run.last * run.dt + run.dt / 2;
    now.textContent = (story.paths ? onPlane(pen, colour, screen, step, wide) : overTime(pen, colour, screen, step, wide)) + (over ? "; over" : "");
    controls(pen, colour, run, step, wide, high - bars + 4);
  }

  const line = (pen, points, shade, width) => {
    pen.strokeStyle = shade;
    pen.lineWidth = width;
    pen.beginPath();
    for (const point of points) pen.lineTo(...point);
    pen.stroke();
  };

  function onPlane(pen, colour, { run, robot, view, side }, step, size) {
    const passed = reached(run, step);
    seen(pen, colour, { run, robot, view }, passed, step, size);
    if (side) {
      pen.save();
      pen.translate(0, size);
      seen(pen, colour, { run: fromSide(run), robot: fromSide(robot), view: side }, passed, step, size);
      line(pen, [[0, 0], [size, 0]], colour("muted"), 1);
      pen.restore();
    }
    const moved = (i) => side ? Math.hypot(...point(run, i + 1).map((x, k) => x - point(run, i)[k])) : Math.abs(along(run, i));
    return `${((step ? moved(step - 1) : 0) / run.dt).toFixed(2)} m/s${run.radius ? `, ${passed} passed` : ""}`;
  }

  // The position at a sample, with the height of a body in space.
  const point = (run, i) => [run.pose[i][0], run.pose[i][1], ...(run.side ? [run.side[i][1]] : [])];

  // The number of places reached until a sample.
  function reached(run, step) {
    let next = 0;
    for (let i = 1; i <= step && next < run.markers.length; i++) {
      if (Math.hypot(...point(run, i).map((x, k) => x - run.markers[next][k])) <= run.radius) next++;
    }
    return next;
  }

  function seen(pen, colour, { run, robot, view }, passed, step, size) {
    const scale = size / (2 * view.half);
    const at = ([x, y]) => [(x - view.centre[0] + view.half) * scale, (view.centre[1] + view.half - y) * scale];
    pen.save();
    pen.beginPath();
    pen.rect(0, 0, size, size);
    pen.clip();
    for (const wall of run.walls) line(pen, wall.map(at), colour("reference"), 1);
    places(pen, colour, run, passed, at, scale);
    pen.globalAlpha = 0.3;
    line(pen, run.pose.map(at), colour("muted"), 1);
    pen.globalAlpha = 1;
    for (let i = 0; i < step; i++) line(pen, [at(run.pose[i]), at(run.pose[i + 1])], colour(along(run, i) >= 0 ? "blue" : "vermilion"), 2);
    if (run.apart !== null && time >= run.apart) cross(pen, colour("ink"), at(run.pose[Math.min(run.pose.length - 1, Math.round(run.apart / run.dt))]));
    if (robot) body(pen, colour, robot.pose[Math.min(robot.pose.length - 1, Math.round(time / robot.dt))], at, size, true);
    body(pen, colour, run.pose[step], at, size, false);
    ruler(pen, colour, view, scale, size);
    pen.restore();
  }

  // Metres forwards in one step.
  function along(run, i) {
    const [from, to] = [run.pose[i], run.pose[i + 1]];
    return (to[0] - from[0]) * Math.cos(from[2]) + (to[1] - from[1]) * Math.sin(from[2]);
  }

  function places(pen, colour, run, next, at, scale) {
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    run.markers.slice(0, next + 1).forEach((marker, i) => {
      if (i < next - 3) return; // those passed long ago would cover what follows
      const shade = colour(i < next ? "green" : "ink");
      pen.globalAlpha = i < next ? 0.35 : 1;
      pen.strokeStyle = pen.fillStyle = shade;
      pen.lineWidth = 1.5;
      pen.beginPath();
      pen.arc(...at(marker), Math.max(3, run.radius * scale), 0, 2 * Math.PI);
      pen.stroke();
      pen.fillText(String(i + 1), ...at(marker));
      pen.globalAlpha = 1;
    });
  }

  function body(pen, colour, pose, at, size, ghost) {
    const long = size / 22, wide = long / 2;
    pen.save();
    pen.translate(...at(pose));
    pen.rotate(-pose[2]);
    pen.beginPath();
    pen.moveTo(-long / 2, -wide / 2);
    pen.lineTo(long / 5, -wide / 2);
    pen.lineTo(long / 2, 0);
    pen.lineTo(long / 5, wide / 2);
    pen.lineTo(-long / 2, wide / 2);
    pen.closePath();
    pen.fillStyle = colour("ink");
    pen.strokeStyle = colour("muted");
    pen.lineWidth = 1.5;
    if (ghost) pen.stroke();
    else pen.fill();
    pen.restore();
  }

  function cross(pen, shade, [x, y]) {
    line(pen, [[x - 4, y - 4], [x + 4, y + 4]], shade, 1.5);
    line(pen, [[x - 4, y + 4], [x + 4, y - 4]], shade, 1.5);
  }

  function ruler(pen, colour, view, scale, size) {
    const power = 10 ** Math.floor(Math.log10(view.half)), metres = [5, 2, 1].map((n) => n * power).find((length) => length <= 0.6 * view.half) ?? power / 2;
    line(pen, [[8, size - 8], [8 + metres * scale, size - 8]], colour("muted"), 1.5);
    pen.fillStyle = colour("muted");
    pen.textAlign = "left";
    pen.textBaseline = "bottom";
    pen.fillText(`${number(metres)} m`, 8, size - 11);
  }

  function overTime(pen, colour, { run, robot }, step, wide) {
    story.shown.forEach((place, i) => strip(pen, colour, run, robot, step, place, wide, i * STRIP));
    const named = story.shown.map((place) => {
      const { name, unit } = story.states[place];
      const size = Math.max(...run.states.map((state) => Math.abs(state[place])).filter(Number.isFinite));
      return `${name} ${inRange(nearest(run, place, step), size)} ${unit}`.trim();
    });
    return named.join(", ");
  }

  const targetOf = (run, place) => run.targets.find((target) => target.place === place);

  // The target of a state at a sample; without one its value at rest.
  function wantedOf(run, place, i) {
    const target = targetOf(run, place);
    return target ? target.values[Math.min(i, target.values.length - 1)] : story.states[place].neutral;
  }

  // A state at a sample; a periodic one as the value nearest to its target.
  function nearest(run, place, i) {
    const { period } = story.states[place], value = run.states[i][place];
    return period ? value - period * Math.round((value - wantedOf(run, place, i)) / period) : value;
  }

  // One state over time: blue up to now, grey its target, dotted the state on the robot.
  function strip(pen, colour, run, robot, step, place, wide, top) {
    const state = story.states[place], target = targetOf(run, place), start = state.period ? DIAL : 0;
    const wanted = (i) => wantedOf(run, place, i);
    const series = (one) => one.states.map((_, i) => nearest(one, place, i));
    const [own, other] = [series(run), robot ? series(robot) : []];
    if (state.period) dial(pen, colour, run, robot, step, place, top);
    const everything = [...(robot ? other : own), ...own.filter((value) => state.low === null || state.high === null || (value >= state.low && value <= state.high))];
    if (target) everything.push(...target.values.map((value) => value + target.tolerance), ...target.values.map((value) => value - target.tolerance));
    if (state.period) everything.push(wanted(0) - state.period / 2, wanted(0) + state.period / 2);
    const known = everything.filter(Number.isFinite);
    let [low, high] = [Math.min(...known), Math.max(...known)];
    if (!(high > low)) [low, high] = [low - 1, high + 1];
    const bottom = top + STRIP - 6, roof = top + 18, last = Number(slider.max) || 1;
    const at = (i, value) => [start + ((i * run.dt) / last) * (wide - start), bottom - ((value - low) / (high - low)) * (bottom - roof)];
    pen.save();
    pen.beginPath();
    pen.rect(start, roof - 2, wide - start, bottom - roof + 4);
    pen.clip();
    if (target) {
      const edge = own.map((_, i) => at(i, wanted(i) + target.tolerance)[1]);
      const other = own.map((_, i) => at(i, wanted(i) - target.tolerance)[1]);
      pen.fillStyle = colour("reference");
      pen.globalAlpha = 0.2;
      pen.beginPath();
      edge.forEach((y, i) => pen.lineTo(at(i, 0)[0], y));
      other.reverse().forEach((y, i) => pen.lineTo(at(own.length - 1 - i, 0)[0], y));
      pen.fill();
      pen.globalAlpha = 1;
      line(pen, own.map((_, i) => at(i, wanted(i))), colour("reference"), 1);
    }
    const jumps = (values) => values.flatMap((value, i) => (i && state.period && Math.abs(value - values[i - 1]) > state.period / 2 ? [i] : []));
    const traced = (values, shade, width, end) => {
      const cuts = [0, ...jumps(values).filter((i) => i <= end), end + 1];
      for (let k = 0; k + 1 < cuts.length; k++) line(pen, values.slice(cuts[k], cuts[k + 1]).map((value, i) => at(cuts[k] + i, value)), shade, width);
    };
    pen.setLineDash([2, 3]);
    traced(other, colour("muted"), 1, other.length - 1);
    pen.setLineDash([]);
    pen.globalAlpha = 0.3;
    traced(own, colour("blue"), 1, own.length - 1);
    pen.globalAlpha = 1;
    traced(own, colour("blue"), 1.8, step);
    if (run.apart !== null) line(pen, [at(run.apart / run.dt, low), at(run.apart / run.dt, high)], colour("ink"), 0.8);
    pen.fillStyle = colour("ink");
    pen.beginPath();
    pen.arc(...at(step, own[step]), 3, 0, 2 * Math.PI);
    pen.fill();
    pen.restore();
    pen.fillStyle = colour("muted");
    pen.textAlign = "left";
    pen.textBaseline = "top";
    const fine = 10 ** (Math.floor(Math.log10(high - low)) - 1); // two digits of the range are enough
    const [from, to] = [low, high].map((value) => number(Math.round(value / fine) * fine));
    pen.fillText(`${state.name}${state.unit ? ` (${state.unit})` : ""}, ${from} to ${to}`, 0, top + 2);
  }

  // A periodic state as an arm, its target at the top; without one, its value at rest at the bottom.
  function dial(pen, colour, run, robot, step, place, top) {
    const { period } = story.states[place], radius = 25, [x, y] = [radius + 3, top + 20 + radius];
    const arm = (one, i, shade, width) => {
      const turn = (2 * Math.PI * (one.states[i][place] - wantedOf(one, place, i))) / period + (targetOf(one, place) ? 0 : Math.PI);
      line(pen, [[x, y], [x - radius * Math.sin(turn), y - radius * Math.cos(turn)]], shade, width);
    };
    pen.strokeStyle = colour("rule");
    pen.lineWidth = 1;
    pen.beginPath();
    pen.arc(x, y, radius, 0, 2 * Math.PI);
    pen.stroke();
    if (robot) {
      pen.setLineDash([2, 3]);
      arm(robot, Math.min(robot.states.length - 1, Math.round(time / robot.dt)), colour("muted"), 1);
      pen.setLineDash([]);
    }
    arm(run, step, colour("blue"), 3);
  }

  // The controls as bars from neutral.
  function controls(pen, colour, run, step, wide, top) {
    const applied = run.controls[Math.min(step, run.controls.length - 1)];
    const room = Math.min(110, wide * 0.4);
    story.controls.forEach((control, i) => {
      const [low, high] = [control.low ?? -1, control.high ?? 1], y = top + i * BAR + BAR / 2;
      const at = (value) => room + ((Math.min(high, Math.max(low, value)) - low) / (high - low)) * (wide - room - 2);
      pen.fillStyle = colour("muted");
      pen.textAlign = "left";
      pen.textBaseline = "middle";
      pen.fillText(control.name, 0, y, room - 6);
      line(pen, [[at(low), y], [at(high), y]], colour("rule"), 1);
      line(pen, [[at(control.neutral), y - 5], [at(control.neutral), y + 5]], colour("muted"), 1);
      if (applied) line(pen, [[at(control.neutral), y], [at(applied[i]), y]], colour("blue"), 6);
    });
  }

  row.addEventListener("change", () => choose(row.value));
  play.addEventListener("click", () => start(!playing));
  slider.addEventListener("input", () => seek(Number(slider.value)));
  beside.addEventListener("change", pair);
  for (const button of player.querySelectorAll("[data-frames]")) button.addEventListener("click", () => frames(Number(button.dataset.frames)));
  player.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const held = event.target.matches("button, select"); // these have a use for the space bar
    if (event.key === " " && !held) start(!playing);
    else if (event.key === "," || event.key === ".") frames(event.key === "," ? -1 : 1);
    else return;
    event.preventDefault();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => seek(time));
  function watch(name) {
    row.value = name;
    choose(name);
    seek(0);
    player.scrollIntoView();
    play.focus();
    start(true);
  }

  for (const card of document.querySelectorAll(".watch")) {
    const button = element("button", card, `Watch ${card.dataset.row}`);
    button.type = "button";
    button.addEventListener("click", () => watch(card.dataset.row));
  }
  document.addEventListener("watch", (event) => watch(event.detail)); // a dot of a figure
  all.addEventListener("click", () => {
    const on = screens.classList.toggle("all");
    all.setAttribute("aria-pressed", String(on));
    all.textContent = on ? "Show fewer systems" : "Show all systems";
    seek(time);
  });
  player.hidden = false;
  row.value = story.first;
  choose(story.first);
  let width = screens.clientWidth;
  new ResizeObserver(() => {
    if (screens.clientWidth === width) return; // drawing changes the height alone
    width = screens.clientWidth;
    requestAnimationFrame(() => seek(time));
  }).observe(screens);
})();
