// The page sends the held keys many times a second; a key that is not repeated counts as released.

import { MESSAGES } from "./messages.js";
import { Traces } from "./traces.js";
import { View } from "./view.js";

const KEYS = { ArrowUp: 1, KeyW: 1, ArrowDown: 2, KeyS: 2, ArrowLeft: 4, KeyA: 4, ArrowRight: 8, KeyD: 8 };
const EVERY = 25; // ms between two messages
const BACKLOG = 1024; // bytes in the send queue that make another message useless
const STALE = 0.1; // s: with an older pose the command is neutral
const SILENT = 400; // ms without a message of the server
const GOING_AWAY = [1001, 1012], INVALID = 1008; // codes with which the server closes the socket
const part = (id) => document.getElementById(id);
const write = (id, text) => { if (part(id).textContent !== text) part(id).textContent = text; };

const view = new View(part("view"));
const traces = new Traces(part("traces"));
const held = new Map(); // held key (its code) or pointer (its number), and its bit
let socket = null;
let reading = null;
let received = 0; // ms: time of the newest message
let over = false;
let trouble = ""; // why page and server do not match
let tries = 0;

function keys() {
  let bits = 0;
  for (const bit of held.values()) bits |= bit;
  return bits;
}

function send(more) {
  if (socket?.readyState !== WebSocket.OPEN || socket.bufferedAmount > BACKLOG) return;
  const message = { type: "keys", keys: document.hidden ? 0 : keys(), clock: performance.now() / 1000, new_trial: false, ...more };
  socket.send(JSON.stringify(message));
}

function releaseAll() {
  held.clear();
  send();
}

function connect() {
  const address = new URL("socket", location.href);
  address.protocol = "ws:";
  socket = new WebSocket(address);
  socket.onopen = () => { held.clear(); tries = 0; send(); };
  socket.onmessage = (event) => {
    const message = JSON.parse(event.data);
    trouble = problem(message);
    received = performance.now();
    if (trouble) socket.close();
    else if (message.type === "setting") arrange(message);
    else if (message.type === "scenery") view.scenery = traces.scenery = message;
    else look(message);
  };
  socket.onclose = (event) => {
    held.clear();
    over = GOING_AWAY.includes(event.code);
    if (event.code === INVALID) trouble = `The server rejects the messages of this page: ${event.reason}`;
    tries += 1;
    if (!over && !trouble) setTimeout(connect, Math.min(2000, 250 * tries));
  };
}

// The error in a message of the server, in a sentence; empty if it matches the table of messages.
function problem(message) {
  const table = MESSAGES[message?.type];
  if (!table) return `The server sends an unknown message: ${message?.type}`;
  const kind = (value) => value === null ? "null" : Array.isArray(value) ? "array" : typeof value;
  const wrong = Object.keys(table).find((name) => !table[name].includes(kind(message[name])));
  return wrong ? `${message.type}: expected ${wrong} as ${table[wrong].join(" or ")}, got ${kind(message[wrong])}` : "";
}

function look(message) {
  if (message.trial !== reading?.trial) {
    view.clear();
    traces.clear();
  }
  reading = message;
  view.show(message);
  traces.show(message);
}

// Show the elements of this robot and this task: a top view, traces, keys.
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
  if (socket?.readyState !== WebSocket.OPEN) return tries > 3 ? "No answer: is sysid-evo drive still running?" : "Connecting";
  if (!reading) return "";
  if (view.setting.controller !== null) return watched();
  if (!reading.is_driver) return "Watching: another page drives.";
  switch (reading.phase) {
    case "settling": return "Release all keys and wait for the robot to stop.";
    case "ready": return "Press an arrow key to start; the clock starts with it.";
    case "finished": return `Trial over, score ${score(reading.score)}. R starts the next.`;
    case "ended": return reading.message ? `${reading.message}. R starts another trial.` : "R starts a trial.";
    default: return "";
  }
}

function watched() {
  const { controller, playback_speed: speed } = view.setting;
  const pace = speed > 1 ? `, shown at ${speed.toFixed(speed < 10 ? 1 : 0)} times real time` : "";
  if (reading.phase === "settling") return `Waiting for the robot to stop; then ${controller} takes over.`;
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
  const alive = socket?.readyState === WebSocket.OPEN && performance.now() - received < SILENT;
  const watchers = reading?.is_driver && reading.watchers ? `, ${reading.watchers} watching` : "";
  health("page", alive ? "good" : "bad", alive ? (byHand && reading?.is_driver ? "in control" : "watching") + (byHand ? watchers : "") : "not connected");
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
  write("scores", scores.length ? `scores ${scores.slice(-8).map(score).join(" ")}, mean ${mean.toFixed(1)}` : "no finished trial yet");
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
    send();
  } else if (event.code === "Space") {
    event.preventDefault();
    releaseAll();
  } else if (event.code === "KeyR" && !event.repeat) {
    send({ new_trial: true });
  }
});
addEventListener("keyup", (event) => { if (held.delete(event.code)) send(); });
for (const away of ["blur", "pagehide", "contextmenu"]) addEventListener(away, releaseAll);
document.addEventListener("visibilitychange", releaseAll);

for (const button of part("pad").children) {
  button.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    button.setPointerCapture(event.pointerId);
    held.set(event.pointerId, Number(button.dataset.key));
    send();
  });
  button.addEventListener("lostpointercapture", (event) => { if (held.delete(event.pointerId)) send(); });
}
// A long touch opens a menu, which would release the keys.
part("pad").addEventListener("contextmenu", (event) => { event.preventDefault(); event.stopPropagation(); });
part("again").addEventListener("click", () => { part("again").blur(); send({ new_trial: true }); });

setInterval(() => send(), EVERY);
connect();
requestAnimationFrame(frame);
