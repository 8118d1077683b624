// The page says many times a second which keys are held; what it does not say again counts for nothing.

import { MESSAGES } from "./messages.js";
import { Traces } from "./traces.js";
import { View } from "./view.js";

const KEYS = { ArrowUp: 1, KeyW: 1, ArrowDown: 2, KeyS: 2, ArrowLeft: 4, KeyA: 4, ArrowRight: 8, KeyD: 8 };
const EVERY = 25; // ms between two words
const BACKLOG = 1024; // bytes under way that make another word pointless
const STALE = 0.1; // s: an older pose means neutral
const SILENT = 400; // ms without a word of the server
const GOING_AWAY = [1001, 1012], INVALID = 1008; // codes with which the server closes the line
const part = (id) => document.getElementById(id);
const write = (id, text) => { if (part(id).textContent !== text) part(id).textContent = text; };

const view = new View(part("view"));
const traces = new Traces(part("traces"));
const held = new Map(); // what is down (a key's code, a pointer's number) and its bit
let socket = null;
let reading = null;
let heard = 0;
let over = false;
let trouble = ""; // why the two do not understand each other
let tries = 0;

function keys() {
  let bits = 0;
  for (const bit of held.values()) bits |= bit;
  return bits;
}

function say(more) {
  if (socket?.readyState !== WebSocket.OPEN || socket.bufferedAmount > BACKLOG) return;
  const said = { type: "keys", keys: document.hidden ? 0 : keys(), clock: performance.now() / 1000, new: false, ...more };
  socket.send(JSON.stringify(said));
}

function letGo() {
  held.clear();
  say();
}

function connect() {
  const address = new URL("socket", location.href);
  address.protocol = "ws:";
  socket = new WebSocket(address);
  socket.onopen = () => { held.clear(); tries = 0; say(); };
  socket.onmessage = (event) => {
    const said = JSON.parse(event.data);
    trouble = problem(said);
    heard = performance.now();
    if (trouble) socket.close();
    else if (said.type === "setting") arrange(said);
    else if (said.type === "scenery") view.scenery = traces.scenery = said;
    else look(said);
  };
  socket.onclose = (event) => {
    held.clear();
    over = GOING_AWAY.includes(event.code);
    if (event.code === INVALID) trouble = `The server refuses what this page says: ${event.reason}`;
    tries += 1;
    if (!over && !trouble) setTimeout(connect, Math.min(2000, 250 * tries));
  };
}

// What is wrong with a message of the server, in a sentence; empty if it is as the table of messages describes it.
function problem(said) {
  const table = MESSAGES[said?.type];
  if (!table) return `The server says what this page does not know: ${said?.type}`;
  const kind = (value) => value === null ? "null" : Array.isArray(value) ? "array" : typeof value;
  const wrong = Object.keys(table).find((name) => !table[name].includes(kind(said[name])));
  return wrong ? `${said.type}: expected ${wrong} as ${table[wrong].join(" or ")}, got ${kind(said[wrong])}` : "";
}

function look(said) {
  if (said.trial !== reading?.trial) {
    view.clear();
    traces.clear();
  }
  reading = said;
  view.show(said);
  traces.show(said);
}

// Show what this robot and this task have: a top view, traces, keys.
function arrange(setting) {
  view.setting = traces.setting = setting;
  view.half = null;
  document.title = `${setting.robot} – ${setting.controller ?? "driving by hand"}`;
  write("robot", setting.robot);
  write("unit", setting.unit || "score");
  document.body.classList.toggle("by-hand", setting.controller === null);
  part("view").hidden = !setting.top_view;
  part("traces").hidden = !setting.traces.length;
}

function banner() {
  if (trouble) return trouble;
  if (over) return "The session is over.";
  if (socket?.readyState !== WebSocket.OPEN) return tries > 3 ? "No answer: does sysid-evo drive still run?" : "Connecting";
  if (!reading) return "";
  if (view.setting.controller !== null) return watched();
  if (!reading.drives) return "Watching: another page drives.";
  switch (reading.phase) {
    case "settling": return "Release all keys; the robot must stand still.";
    case "ready": return "Press an arrow key to start: the clock starts with it.";
    case "finished": return `Trial over, score ${score(reading.score)}. R starts the next.`;
    case "ended": return reading.message ? `${reading.message}. R starts another trial.` : "R starts a trial.";
    default: return "";
  }
}

function watched() {
  const { controller, faster } = view.setting;
  const pace = faster > 1 ? `, ${faster.toFixed(faster < 10 ? 1 : 0)} times as fast` : "";
  if (reading.phase === "settling") return `Waiting until the robot stands; then ${controller} drives.`;
  return reading.phase === "finished" ? `Trial over, score ${score(reading.score)}.` : `${controller} drives${pace}`;
}

function score(value) {
  return String(Number(value.toFixed(Math.abs(value) < 100 ? 2 : 1)));
}

function signed(value) {
  return `${value > 0 ? "+" : value < 0 ? "−" : ""}${Number(Math.abs(value).toPrecision(3))}`;
}

function health(id, state, text) {
  part(id).dataset.state = state;
  write(id, text);
}

function panel() {
  write("banner", banner());
  const { setting } = view, byHand = setting.controller === null;
  const alive = socket?.readyState === WebSocket.OPEN && performance.now() - heard < SILENT;
  const watchers = reading?.drives && reading.watchers ? `, ${reading.watchers} watching` : "";
  health("page", alive ? "good" : "bad", alive ? (byHand && reading?.drives ? "in control" : "watching") + (byHand ? watchers : "") : "not connected");
  if (!reading) return;
  write("trial", `trial ${reading.trial}`);
  write("score", score(reading.score));
  write("time", ((setting.horizon - reading.step) * setting.dt).toFixed(1));
  const speed = reading.state?.[setting.forward] ?? null;
  part("speed").closest("div").hidden = speed === null && !setting.top_view;
  write("speed", (speed ?? 0).toFixed(2));
  write("command", reading.control ? setting.controls.map((name, i) => `${name} ${signed(reading.control[i])}`).join(" · ") : "neutral");
  const { scores, tracker_age: age, link } = reading;
  if (age === null || !reading.control) health("tracker", "off", "–");
  else if (age > STALE) health("tracker", "bad", `silent ${age.toFixed(1)} s`);
  else health("tracker", "good", `${reading.tracker_rate} Hz`);
  if (!link || !reading.control) health("link", "off", "–");
  else health("link", link === "tripped" || reading.link_age > 0.25 ? "bad" : "good", link);
  const mean = scores.reduce((sum, score) => sum + score, 0) / scores.length;
  write("scores", scores.length ? `scores ${scores.slice(-8).map(score).join(" ")}, mean ${mean.toFixed(1)}` : "no trial driven to its end yet");
  for (const button of part("pad").children) button.classList.toggle("held", Boolean(reading.keys & button.dataset.key));
}

function frame() {
  panel();
  view.draw();
  traces.draw();
  requestAnimationFrame(frame);
}

addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.code in KEYS) {
    event.preventDefault();
    if (event.repeat) return;
    held.set(event.code, KEYS[event.code]);
    say();
  } else if (event.code === "Space") {
    event.preventDefault();
    letGo();
  } else if (event.code === "KeyR" && !event.repeat) {
    say({ new: true });
  }
});
addEventListener("keyup", (event) => { if (held.delete(event.code)) say(); });
for (const away of ["blur", "pagehide", "contextmenu"]) addEventListener(away, letGo);
document.addEventListener("visibilitychange", letGo);

for (const button of part("pad").children) {
  button.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    button.setPointerCapture(event.pointerId);
    held.set(event.pointerId, Number(button.dataset.key));
    say();
  });
  button.addEventListener("lostpointercapture", (event) => { if (held.delete(event.pointerId)) say(); });
}
// A long touch asks for a menu, which would let go of the keys.
part("pad").addEventListener("contextmenu", (event) => { event.preventDefault(); event.stopPropagation(); });
part("again").addEventListener("click", () => { part("again").blur(); say({ new: true }); });

setInterval(() => say(), EVERY);
connect();
requestAnimationFrame(frame);
