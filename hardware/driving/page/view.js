// The top view: metres, x to the right, y up; poses of the tracker, nothing predicted.

import { Plot } from "./plot.js";

const CAR = { length: 0.17, width: 0.08 }; // m
const MARGIN = 0.35; // m of floor around the arena and the robot
const SPACING = 0.01; // m between two points of the trail
const TRAIL = 4000; // points

const metres = (value) => String(value).replace("-", "−");

export class View extends Plot {
  half = null; // m from the middle to the nearer edge

  clear() {
    this.trail = [];
    this.passed = [];
    this.pose = null;
    this.waypoint = null;
  }

  show(reading) {
    const next = reading.waypoint;
    if (this.waypoint && next && (next[0] !== this.waypoint[0] || next[1] !== this.waypoint[1])) this.passed.push(this.waypoint);
    this.waypoint = next;
    this.pose = reading.pose?.length ? reading.pose : null;
    if (this.pose) {
      const last = this.trail.at(-1);
      if (!last || Math.hypot(this.pose[0] - last[0], this.pose[1] - last[1]) >= SPACING) this.trail.push(this.pose);
      if (this.trail.length > TRAIL) this.trail.shift();
    }
  }

  paint(wide, high) {
    this.zoom(Math.min(wide, high));
    this.middle = [wide / 2, high / 2];
    this.grid(wide, high);
    this.task();
    this.path();
    if (this.pose) this.car(this.pose);
    this.ruler(high);
  }

  zoom(size) {
    const reach = (this.setting.arena ?? 1.5) + (this.setting.waypoint_radius ?? 0);
    const away = this.pose ? Math.max(Math.abs(this.pose[0]), Math.abs(this.pose[1])) : 0;
    const wanted = Math.max(reach, away) + MARGIN;
    this.half = this.half === null || !this.pose ? wanted : this.half + 0.08 * (wanted - this.half);
    this.scale = size / (2 * this.half);
  }

  at(point) {
    return [this.middle[0] + point[0] * this.scale, this.middle[1] - point[1] * this.scale];
  }

  circle(centre, radius) {
    this.pen.beginPath();
    this.pen.arc(...this.at(centre), radius, 0, 2 * Math.PI);
  }

  grid(wide, high) {
    const { pen } = this, step = this.half > 6 ? 2 : this.half > 3 ? 1 : 0.5;
    const columns = Math.floor(this.middle[0] / this.scale / step), rows = Math.floor(this.middle[1] / this.scale / step);
    pen.lineWidth = 1;
    for (let i = -columns; i <= columns; i++) this.line([this.at([i * step, 0])[0], 0], [this.at([i * step, 0])[0], high], i === 0);
    for (let i = -rows; i <= rows; i++) this.line([0, this.at([0, i * step])[1]], [wide, this.at([0, i * step])[1]], i === 0);
    pen.fillStyle = this.colour("--soft");
    pen.textAlign = "center";
    pen.textBaseline = "bottom";
    for (let i = -columns; i <= columns; i++) {
      const x = this.at([i * step, 0])[0];
      if (i % 2 === 0 && x > 90 && x < wide - 24) pen.fillText(metres(i * step), x, high - 4);
    }
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (let i = -rows; i <= rows; i++) {
      const y = this.at([0, i * step])[1];
      if (i % 2 === 0 && y > 12 && y < high - 30) pen.fillText(metres(i * step), wide - 6, y);
    }
  }

  line(from, to, axis) {
    const { pen } = this;
    pen.strokeStyle = this.colour(axis ? "--axis" : "--grid");
    pen.beginPath();
    pen.moveTo(Math.round(from[0]) + 0.5, Math.round(from[1]) + 0.5);
    pen.lineTo(Math.round(to[0]) + 0.5, Math.round(to[1]) + 0.5);
    pen.stroke();
  }

  task() {
    const { pen, setting } = this;
    if (setting.arena && !this.scenery.walls?.length) {
      pen.strokeStyle = this.colour("--arena");
      pen.lineWidth = 1.5;
      pen.setLineDash([6, 5]);
      this.circle([0, 0], setting.arena * this.scale);
      pen.stroke();
      pen.setLineDash([]);
    }
    pen.strokeStyle = this.colour("--ink");
    pen.lineWidth = 1.5;
    for (const wall of this.scenery.walls ?? []) {
      pen.beginPath();
      for (const point of wall) pen.lineTo(...this.at(point));
      pen.stroke();
    }
    pen.strokeStyle = this.colour("--axis");
    for (const point of this.passed) {
      this.circle(point, 4);
      pen.stroke();
    }
    if (!this.waypoint || !setting.waypoint_radius) return;
    pen.fillStyle = pen.strokeStyle = this.colour("--goal");
    pen.lineWidth = 2;
    this.circle(this.waypoint, setting.waypoint_radius * this.scale);
    pen.globalAlpha = 0.16;
    pen.fill();
    pen.globalAlpha = 1;
    pen.stroke();
    this.circle(this.waypoint, 3);
    pen.fill();
  }

  path() {
    const { pen } = this;
    if (this.trail.length < 2) return;
    pen.strokeStyle = this.colour("--trail");
    pen.lineWidth = 2;
    pen.lineJoin = "round";
    pen.globalAlpha = 0.7;
    pen.beginPath();
    for (const point of this.trail) pen.lineTo(...this.at(point));
    pen.stroke();
    pen.globalAlpha = 1;
  }

  car([x, y, heading]) {
    const { pen } = this, long = CAR.length * this.scale, wide = CAR.width * this.scale;
    pen.save();
    pen.translate(...this.at([x, y]));
    pen.rotate(-heading);
    pen.fillStyle = this.colour("--car");
    pen.beginPath();
    pen.roundRect(-long / 2, -wide / 2, long, wide, wide / 4);
    pen.fill();
    pen.fillStyle = this.colour("--sheet");
    pen.beginPath();
    pen.moveTo(long * 0.42, 0);
    pen.lineTo(long * 0.1, wide * 0.32);
    pen.lineTo(long * 0.1, -wide * 0.32);
    pen.fill();
    pen.restore();
  }

  ruler(high) {
    const { pen } = this, length = this.half > 3 ? 1 : 0.5;
    pen.strokeStyle = pen.fillStyle = this.colour("--ink");
    pen.lineWidth = 1.5;
    const [left, bottom, right] = [16, high - 16, 16 + length * this.scale];
    pen.beginPath();
    pen.moveTo(left, bottom - 5);
    pen.lineTo(left, bottom);
    pen.lineTo(right, bottom);
    pen.lineTo(right, bottom - 5);
    pen.stroke();
    pen.textAlign = "left";
    pen.textBaseline = "bottom";
    pen.fillText(`${length} m`, left + 4, bottom - 4);
  }
}
