// States and controls over time, one strip each: values in colour, targets in grey.

import { Plot } from "./plot.js";

const LEFT = 52, RIGHT = 10, GAP = 12, HEAD = 18, FOOT = 20; // px
const SPARE = 0.06; // margin above and below the values, as a share of the range

export class Traces extends Plot {
  clear() {
    this.samples = [];
  }

  show(reading) {
    if (!reading.state || !["driving", "finished"].includes(reading.phase)) return;
    const last = this.samples.at(-1);
    if (last && last.step === reading.step) return;
    this.samples.push({ step: reading.step, state: reading.state, control: reading.control });
  }

  paint(wide, high) {
    const { setting } = this;
    if (!setting.traces?.length) return;
    const all = [...setting.traces, ...setting.control_traces], each = (high - FOOT - GAP) / all.length;
    all.forEach((trace, i) => this.strip(trace, GAP + i * each, each, wide, i >= setting.traces.length));
    this.clock(wide, high);
  }

  // Position of a strip, and the conversion of a step and a value to a point in it.
  frame(range, top, tall, wide) {
    const { horizon } = this.setting, up = top + HEAD, down = top + tall - GAP;
    return {
      up, down, right: wide - RIGHT,
      x: (step) => LEFT + (step / horizon) * (wide - RIGHT - LEFT),
      y: (value) => down - ((value - range[0]) / (range[1] - range[0])) * (down - up),
    };
  }

  strip(trace, top, tall, wide, isControl) {
    const target = isControl ? null : this.scenery.targets?.find((one) => one.place === trace.place);
    const wanted = (step) => target ? target.values[Math.min(step, target.values.length - 1)] : trace.neutral;
    const near = (value, step) => trace.period ? wanted(step) + turned(value - wanted(step), trace.period) : value;
    const points = this.samples.map(({ step, state, control }) => {
      const value = isControl ? control?.[trace.place] : state[trace.place];
      return value === null || value === undefined ? null : [step, near(value, step)];
    });
    const range = this.range(trace, target, points, isControl);
    const frame = this.frame(range, top, tall, wide);
    this.grid(trace, range, frame, top, points);
    if (target) this.target(target, frame, wanted);
    this.line(points, frame, trace.period, isControl);
  }

  range(trace, target, points, isControl) {
    const seen = points.filter(Boolean).map((point) => point[1]);
    if (isControl && trace.bounds) seen.push(...trace.bounds);
    if (target) for (const value of target.values) seen.push(value - 2 * target.tolerance, value + 2 * target.tolerance);
    else seen.push(trace.neutral);
    let low = Math.min(...seen), high = Math.max(...seen);
    if (!(high - low > 1e-9)) [low, high] = [low - 1, high + 1];
    const spare = SPARE * (high - low);
    return [low - spare, high + spare];
  }

  grid(trace, range, frame, top, points) {
    const { pen } = this;
    pen.lineWidth = 1;
    pen.strokeStyle = this.colour("--grid");
    pen.fillStyle = this.colour("--soft");
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    const step = nice((range[1] - range[0]) / Math.max(2, Math.min(4, (frame.down - frame.up) / 24)));
    for (let value = Math.ceil(range[0] / step) * step; value <= range[1] + 1e-12; value += step) {
      const y = Math.round(frame.y(value)) + 0.5;
      pen.beginPath();
      pen.moveTo(LEFT, y);
      pen.lineTo(frame.right, y);
      pen.stroke();
      pen.fillText(text(value, step), LEFT - 6, y);
    }
    pen.textBaseline = "top";
    pen.textAlign = "left";
    pen.fillStyle = this.colour("--ink");
    pen.fillText(trace.unit ? `${trace.name} (${trace.unit})` : trace.name, LEFT, top);
    const last = points.findLast(Boolean);
    if (last) {
      pen.textAlign = "right";
      pen.fillText(text(last[1], step / 10), frame.right, top);
    }
  }

  target({ values, tolerance }, frame, wanted) {
    const { pen, setting } = this;
    pen.fillStyle = pen.strokeStyle = this.colour("--arena");
    pen.lineWidth = 1.5;
    const steps = values.length > 1 ? values.map((_, step) => step) : [0, setting.horizon];
    pen.globalAlpha = 0.18;
    pen.beginPath();
    for (const step of steps) pen.lineTo(frame.x(step), frame.y(wanted(step) + tolerance));
    for (const step of [...steps].reverse()) pen.lineTo(frame.x(step), frame.y(wanted(step) - tolerance));
    pen.fill();
    pen.globalAlpha = 1;
    pen.beginPath();
    for (const step of steps) pen.lineTo(frame.x(step), frame.y(wanted(step)));
    pen.stroke();
  }

  line(points, frame, period, isControl) {
    const { pen } = this;
    pen.strokeStyle = this.colour(isControl ? "--goal" : "--car");
    pen.lineWidth = 2;
    pen.lineJoin = "round";
    pen.beginPath();
    let last = null;
    for (const point of points) {
      if (point) {
        const jumps = last && period && Math.abs(point[1] - last[1]) > period / 2;
        const [x, y] = [frame.x(point[0]), frame.y(point[1])];
        if (!last || jumps) pen.moveTo(x, y);
        else {
          if (isControl) pen.lineTo(x, frame.y(last[1]));
          pen.lineTo(x, y);
        }
      }
      last = point;
    }
    pen.stroke();
    if (last) {
      pen.fillStyle = pen.strokeStyle;
      pen.beginPath();
      pen.arc(frame.x(last[0]), frame.y(last[1]), 3, 0, 2 * Math.PI);
      pen.fill();
    }
  }

  clock(wide, high) {
    const { pen, setting } = this, seconds = setting.horizon * setting.dt;
    const step = nice(seconds / Math.max(2, Math.min(8, wide / 110)));
    pen.fillStyle = this.colour("--soft");
    pen.textBaseline = "bottom";
    for (let time = 0; time <= seconds + 1e-9; time += step) {
      pen.textAlign = time === 0 ? "left" : time > seconds - step / 2 ? "right" : "center";
      pen.fillText(`${text(time, step)}${time === 0 ? " s" : ""}`, LEFT + (time / seconds) * (wide - RIGHT - LEFT), high - 2);
    }
  }
}

// The angle nearest to 0 that differs by whole periods.
function turned(value, period) {
  return value - period * Math.round(value / period);
}

function nice(step) {
  const power = 10 ** Math.floor(Math.log10(step)), share = step / power;
  return power * (share <= 1 ? 1 : share <= 2 ? 2 : share <= 5 ? 5 : 10);
}

function text(value, step) {
  const digits = Math.max(0, Math.min(6, -Math.floor(Math.log10(step) + 1e-9)));
  return value.toFixed(digits).replace(/^-(0(\.0*)?)$/, "$1").replace("-", "−");
}
