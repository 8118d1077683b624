// The page says many times a second which keys are held; what it does not say again counts for nothing.

import { View } from "./view.js";

const KEYS = { ArrowUp: 1, KeyW: 1, ArrowDown: 2, KeyS: 2, ArrowLeft: 4, KeyA: 4, ArrowRight: 8, KeyD: 8 };
const EVERY = 25; // ms between two words
const BACKLOG = 1024; // bytes under way that make another word pointless
const STALE = 0.1; // s: an older pose means neutral
const SILENT = 400; // ms without a word of the server
const GOING_AWAY = [1001, 1012];
const part = (id) => document.getElementById(id);
const write = (id, text) => { if (part(id).textContent !== text) part(id).textContent = text; };

const view = new View(part("view"));
const held = new Map(); // what is down (a key's code, a pointer's number) and its bit
let socket = null;
let reading = null;
let heard = 0;
let over = false;
let tries = 0;

function keys() {
  let bits = 0;
  for (const bit of held.values()) bits |= bit;
  return bits;
}

function say(more) {
  if (socket?.readyState !== WebSocket.OPEN || socket.bufferedAmount > BACKLOG) return;
  socket.send(JSON.stringify({ keys: document.hidden ? 0 : keys(), clock: performance.now() / 1000, ...more }));
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
    heard = performance.now();
    if (said.setting) {
      view.setting = said.setting;
      view.half = null;
      document.title = `${said.setting.robot} – driving by hand`;
      write("robot", said.setting.robot);
      write("unit", said.setting.unit || "score");
      return;
    }
    if (!reading || said.trial !== reading.trial) view.clear();
    reading = said;
    view.show(said);
  };
  socket.onclose = (event) => {
    held.clear();
    over = GOING_AWAY.includes(event.code);
    tries += 1;
    if (!over) setTimeout(connect, Math.min(2000, 250 * tries));
  };
}

function banner() {
  if (over) return "The session is over.";
  if (socket?.readyState !== WebSocket.OPEN) return tries > 3 ? "No answer: does sysid-evo drive still run?" : "Connecting";
  if (!reading) return "";
  if (!reading.drives) return "Watching: another page drives.";
  switch (reading.phase) {
    case "settling": return "Release all keys; the robot must stand still.";
    case "ready": return "Press an arrow key to start: the clock starts with it.";
    case "finished": return `Trial over, score ${reading.score}. R starts the next.`;
    case "ended": return reading.message ? `${reading.message}. R starts another trial.` : "R starts a trial.";
    default: return "";
  }
}

function signed(value) {
  return `${value > 0 ? "+" : value < 0 ? "−" : ""}${Math.abs(value)}`;
}

function health(id, state, text) {
  part(id).dataset.state = state;
  write(id, text);
}

function panel() {
  write("banner", banner());
  const alive = socket?.readyState === WebSocket.OPEN && performance.now() - heard < SILENT;
  const watchers = reading?.drives && reading.watchers ? `, ${reading.watchers} watching` : "";
  health("page", alive ? "good" : "bad", alive ? (reading?.drives ? "in control" : "watching") + watchers : "not connected");
  if (!reading) return;
  write("trial", `trial ${reading.trial}`);
  write("score", String(reading.score));
  write("time", reading.time_left.toFixed(1));
  write("speed", (reading.speed ?? 0).toFixed(2));
  const names = view.setting.controls ?? [];
  write("command", reading.control ? names.map((name, i) => `${name} ${signed(reading.control[i])}`).join(" · ") : "neutral");
  const { tracker, link, scores } = reading;
  if (!tracker || !reading.control) health("tracker", "off", "–");
  else if (tracker.age > STALE) health("tracker", "bad", `silent ${tracker.age.toFixed(1)} s`);
  else health("tracker", "good", `${tracker.rate} Hz`);
  if (!link || !reading.control) health("link", "off", "–");
  else health("link", link.state === "tripped" || link.age > 0.25 ? "bad" : "good", link.state);
  const mean = scores.reduce((sum, score) => sum + score, 0) / scores.length;
  write("scores", scores.length ? `scores ${scores.slice(-8).join(" ")}, mean ${mean.toFixed(1)}` : "no trial driven to its end yet");
  for (const button of part("pad").children) button.classList.toggle("held", Boolean(reading.keys & button.dataset.key));
}

function frame() {
  panel();
  view.draw();
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
