"use strict";
// What the scripts of all pages share: elements, numbers, a clock, charts (SVG) and top views
// (canvas).
const D = JSON.parse(document.getElementById("data").textContent);
const content = document.getElementById("content");
const SVG_TAGS = new Set([
  "svg",
  "g",
  "line",
  "polyline",
  "path",
  "rect",
  "circle",
  "text",
  "title",
]);
const reducedMotion = matchMedia("(prefers-reduced-motion: reduce)");
const darkScheme = matchMedia("(prefers-color-scheme: dark)");

// -- elements and numbers -------------------------------------------------------------------------

function make(tag, attributes = {}, ...children) {
  const isSvg = SVG_TAGS.has(tag);
  const element = isSvg
    ? document.createElementNS("http://www.w3.org/2000/svg", tag)
    : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) {
      element[name] = value;
    } else if (value !== undefined && value !== null && value !== false) {
      element.setAttribute(name, value === true ? "" : value);
    }
  }
  element.append(...children.filter(child => child !== null && child !== undefined));
  return element;
}

// Row with the names of a table's columns; those of `numbers` are columns of numbers.
function headOf(heads, numbers) {
  const cells = heads.map(name =>
    make("th", {scope: "col", class: numbers.includes(name) ? "number" : null}, name),
  );
  return make("thead", {}, make("tr", {}, ...cells));
}

// A table with the names of its columns. Where it is wider than the page, it scrolls by itself.
function wideTable(heads, body, attributes = {}, numbers = []) {
  const table = make("table", attributes, headOf(heads, numbers), body);
  return make("div", {class: "wide", tabindex: 0}, table);
}

function fixed(value, digits) {
  return value.toFixed(digits).replace("-", "−");
}

// At most three significant digits, without trailing zeros.
function short(value) {
  return String(Number(value.toPrecision(3))).replace("-", "−");
}

function color(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

function methodColor(index) {
  return `var(--method-${index})`;
}

// Outlines of the methods' dots, by the index of the method's colour: they are told apart without
// colours, too.
const DOTS = [
  "M-4.5 0a4.5 4.5 0 1 0 9 0a4.5 4.5 0 1 0 -9 0z",
  "M-4 -4h8v8h-8z",
  "M0 -5L5.2 4.4h-10.4z",
  "M0 -5.8L5.8 0L0 5.8L-5.8 0z",
  "M0 5L5.2 -4.4h-10.4z",
  "M-1.8 -5.4h3.6v3.6h3.6v3.6h-3.6v3.6h-3.6v-3.6h-3.6v-3.6h3.6z",
];
// Dashes [px] of the methods' lines, likewise.
const DASHES = [[7, 4], [], [14, 4, 2, 4], [2, 3], [14, 5], [6, 2, 2, 2]];

// [{swatch: "line", color: "var(--goal)", words: "start"}, ...]; dot: an outline instead of a swatch
function legend(entries) {
  const items = entries.map(entry => make("li", {}, swatchOf(entry), entry.words));
  return make("ul", {class: "legend"}, ...items);
}

function swatchOf({swatch = "", color: shade = "none", dot, dash}) {
  if (dot) {
    const path = make("path", {d: dot, transform: "translate(7 7)", style: `fill: ${shade}`});
    return make("svg", {class: "dot", width: 14, height: 14, "aria-hidden": "true"}, path);
  }
  if (dash && dash.length) {
    const [x2, y] = [28, 4];
    const style = `stroke: ${shade}; stroke-width: 3; stroke-dasharray: ${dash.join(" ")}`;
    const line = make("line", {x2, y1: y, y2: y, style});
    return make("svg", {class: "dot", width: x2, height: 2 * y, "aria-hidden": "true"}, line);
  }
  return make("span", {class: `swatch ${swatch}`, style: `--swatch: ${shade}`});
}

// Round values within [low, high], about `count` of them.
function ticksOf(low, high, count) {
  const rough = (high - low) / Math.max(count, 1) || 1;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find(factor => factor * power >= rough);
  const ticks = [];
  for (let n = Math.ceil(low / step - 1e-9); n * step <= high + 1e-9 * step; n++)
    ticks.push(Number((n * step).toPrecision(12)));
  return ticks;
}

// Index of the last entry of ascending `times` that is not after `time`, at least 0.
function indexAt(times, time) {
  let low = 0;
  let high = times.length - 1;
  while (low < high) {
    const middle = Math.ceil((low + high) / 2);
    if (times[middle] <= time + 1e-9) low = middle;
    else high = middle - 1;
  }
  return low;
}

function rangeOf(values) {
  let low = Infinity;
  let high = -Infinity;
  for (const value of values) {
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  return [low, high];
}

// -- clock ----------------------------------------------------------------------------------------

// Time of a drive [s], moved by one slider, by playing, and by a pointer on a chart. Everything
// that shows it listens.
class Clock {
  constructor(end, rates) {
    this.end = end;
    this.time = 0;
    this.isPlaying = false;
    this.listeners = [];
    this.button = make("button", {type: "button", onclick: () => this.toggle()}, "Play");
    this.slider = make("input", {
      type: "range",
      min: 0,
      step: 0.1,
      value: 0,
      "aria-label": "Time in seconds",
    });
    this.slider.oninput = () => {
      this.pause();
      this.set(Number(this.slider.value));
    };
    this.rate = make("select", {"aria-label": "Speed of playing"});
    for (const rate of rates) this.rate.append(make("option", {value: rate}, `${rate} ×`));
    // While it plays, a reader of the screen would hear nothing else.
    this.output = make("output", {"aria-live": "off"});
    this.controls = make(
      "div",
      {class: "controls"},
      this.button,
      this.slider,
      this.output,
      this.rate,
    );
    this.restart(end);
  }

  restart(end) {
    this.end = end;
    this.slider.max = end;
    this.set(0);
  }

  set(time) {
    this.time = Math.min(Math.max(time, 0), this.end);
    this.slider.value = this.time;
    const words = `${fixed(this.time, 1)} of ${fixed(this.end, 1)} s`;
    this.output.textContent = words;
    this.slider.setAttribute("aria-valuetext", words);
    for (const listener of this.listeners) listener(this.time);
  }

  pause() {
    this.isPlaying = false;
    this.button.textContent = "Play";
  }

  toggle() {
    if (this.isPlaying) {
      this.pause();
    } else {
      if (this.time >= this.end) this.set(0);
      this.play();
    }
  }

  play() {
    this.isPlaying = true;
    this.button.textContent = "Pause";
    let last = null;
    const frame = now => {
      if (!this.isPlaying) return;
      const seconds = last === null ? 0 : (now - last) / 1000;
      last = now;
      this.set(this.time + seconds * this.rate.value);
      if (this.time >= this.end) this.pause();
      requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  }
}

// -- charts ---------------------------------------------------------------------------------------

// Lines and points over a common axis.
// options: title, height, x and y: [low, high]; xTitle; ticks: [count x, count y]; whole: only
// whole numbers on x;
//   lines: [{color, points: [[x, y], ...], isStep, dash: [px, px]}];
//   dots: [{color, points, outline: one of DOTS}];
//   marks: [{x, words}] on the x axis;
//   hasEnds: the ends of y instead of round values;
//   bands: [[low, high, color], ...]; onpick(x): called for a pointer at x; ondraw(): called after each
//   drawing
class Chart {
  constructor(host, options) {
    this.options = {
      height: 160,
      ticks: [6, 3],
      lines: [],
      dots: [],
      marks: [],
      bands: [],
      ...options,
    };
    this.element = make("div", {class: options.onpick ? "chart pick" : "chart"});
    host.append(this.element);
    if (options.onpick) this.listen();
    new ResizeObserver(() => this.draw()).observe(this.element);
  }

  update(options) {
    Object.assign(this.options, options);
    this.draw();
  }

  listen() {
    const pick = event => {
      const left = this.element.getBoundingClientRect().left;
      const share = (event.clientX - left - this.left) / (this.width - this.left - this.right);
      const [low, high] = this.options.x;
      this.options.onpick(low + Math.min(Math.max(share, 0), 1) * (high - low));
    };
    this.element.onpointerdown = event => {
      this.element.setPointerCapture(event.pointerId);
      pick(event);
    };
    this.element.onpointermove = event => {
      if (event.buttons || this.options.onhover) pick(event);
    };
  }

  px(x) {
    const [low, high] = this.options.x;
    return this.left + ((x - low) / (high - low || 1)) * (this.width - this.left - this.right);
  }

  py(y) {
    const [low, high] = this.options.y;
    return this.bottom - ((y - low) / (high - low || 1)) * (this.bottom - this.top);
  }

  draw() {
    const o = this.options;
    this.width = this.element.clientWidth;
    if (!this.width) return;
    [this.left, this.right, this.top] = [o.ticks[1] ? 40 : 2, 8, o.title ? 24 : 8];
    this.bottom = o.height - (o.ticks[0] ? 22 : 4) - (o.xTitle ? 18 : 0);
    const svg = make("svg", {height: o.height, "aria-hidden": "true"});
    for (const [low, high, shade] of o.bands) {
      const width = Math.max(this.px(high) - this.px(low), 2);
      svg.append(
        make("rect", {
          class: "band",
          x: this.px(low),
          y: this.top,
          width,
          height: this.bottom - this.top,
          style: shade && `fill: ${shade}`,
        }),
      );
    }
    this.drawAxes(svg);
    for (const line of o.lines) this.drawLine(svg, line);
    for (const series of o.dots) this.drawDots(svg, series);
    for (const mark of o.marks) {
      const at = this.px(mark.x);
      svg.append(
        make("line", {
          x1: at,
          x2: at,
          y1: this.bottom - 7,
          y2: this.bottom,
          stroke: mark.color || "var(--ink)",
          "stroke-width": 1.5,
        }),
      );
    }
    this.line = make("line", {
      class: "cursor",
      y1: this.top,
      y2: this.bottom,
      visibility: "hidden",
    });
    svg.append(this.line);
    if (o.title) {
      this.title = make("text", {class: "title", x: 0, y: 13}, o.title);
      svg.append(this.title);
    }
    this.element.replaceChildren(svg);
    if (this.at !== undefined) this.cursor(this.at, this.words);
    if (o.ondraw) o.ondraw();
  }

  drawAxes(svg) {
    const o = this.options;
    const values = o.hasEnds ? o.y : ticksOf(...o.y, o.ticks[1]);
    for (const value of o.ticks[1] ? values : []) {
      const at = this.py(value);
      svg.append(
        make("line", {class: "grid", x1: this.left, x2: this.width - this.right, y1: at, y2: at}),
      );
      svg.append(make("text", {x: this.left - 6, y: at + 4, "text-anchor": "end"}, short(value)));
    }
    svg.append(
      make("line", {
        class: "axis",
        x1: this.left,
        x2: this.width - this.right,
        y1: this.bottom,
        y2: this.bottom,
      }),
    );
    const count = Math.min(o.ticks[0], Math.floor(this.width / 60));
    for (const value of count ? ticksOf(...o.x, count) : []) {
      if (o.whole && value % 1) continue;
      svg.append(
        make(
          "text",
          {x: this.px(value), y: this.bottom + 16, "text-anchor": "middle"},
          short(value),
        ),
      );
    }
    if (o.xTitle) {
      const middle = (this.left + this.width - this.right) / 2;
      svg.append(make("text", {x: middle, y: o.height - 3, "text-anchor": "middle"}, o.xTitle));
    }
  }

  drawLine(svg, line) {
    const points = [];
    line.points.forEach(([x, y], n) => {
      if (line.isStep && n) points.push([this.px(x), points[points.length - 1][1]]);
      points.push([this.px(x), this.py(y)]);
    });
    const words = points.map(point => point.map(value => value.toFixed(1)).join(",")).join(" ");
    svg.append(
      make("polyline", {
        points: words,
        style: `stroke: ${line.color}`,
        "stroke-dasharray": line.dash && line.dash.join(" "),
      }),
    );
  }

  drawDots(svg, series) {
    for (const [x, y] of series.points) {
      const transform = `translate(${this.px(x)} ${this.py(y)})`;
      svg.append(make("path", {d: series.outline, transform, style: `fill: ${series.color}`}));
    }
  }

  // Show a vertical line at x, and words as the title.
  cursor(x, words) {
    this.at = x;
    this.words = words;
    if (!this.line) return;
    const at = this.px(x);
    this.line.setAttribute("x1", at);
    this.line.setAttribute("x2", at);
    this.line.setAttribute("visibility", "visible");
    if (words !== undefined && this.title) this.title.textContent = words;
  }
}

// -- top view -------------------------------------------------------------------------------------

// Canvas that shows a part of the plane, turned by a right angle if it then fills its room better.
// box: [left, low, right, high] [m]; paint(view): draws in metres on view.c; words: text for those
// who do not see it.
class TopView {
  constructor(host, box, paint, words, height = () => Math.min(560, 0.75 * innerHeight)) {
    this.box = box;
    this.paint = paint;
    this.height = height;
    this.canvas = make("canvas", {role: "img", "aria-label": words});
    this.element = make("div", {class: "view"}, this.canvas);
    host.append(this.element);
    this.c = this.canvas.getContext("2d");
    new ResizeObserver(() => this.resize()).observe(this.element);
    darkScheme.addEventListener("change", () => this.draw());
  }

  show(box) {
    this.box = box;
    this.resize();
  }

  resize() {
    const room = this.element.clientWidth;
    const [left, low, right, high] = this.box;
    const [across, along] = [right - left, high - low];
    const most = this.height();
    const upright = Math.min(room / across, most / along);
    const turned = Math.min(room / along, most / across);
    this.isTurned = turned > 1.1 * upright;
    this.scale = Math.max(upright, this.isTurned ? turned : 0);
    this.width = (this.isTurned ? along : across) * this.scale;
    this.tall = (this.isTurned ? across : along) * this.scale;
    this.ratio = devicePixelRatio || 1;
    this.canvas.width = Math.round(this.width * this.ratio);
    this.canvas.height = Math.round(this.tall * this.ratio);
    this.canvas.style.width = `${this.width}px`;
    this.canvas.style.height = `${this.tall}px`;
    this.draw();
  }

  // Place of a point [m] on the canvas [px].
  at(x, y) {
    const [left, low, , high] = this.box;
    return this.isTurned
      ? [(y - low) * this.scale, (x - left) * this.scale]
      : [(x - left) * this.scale, (high - y) * this.scale];
  }

  pixels() {
    this.c.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
  }

  metres() {
    const s = this.scale * this.ratio;
    const [left, low, , high] = this.box;
    if (this.isTurned) this.c.setTransform(0, s, s, 0, -low * s, -left * s);
    else this.c.setTransform(s, 0, 0, -s, -left * s, high * s);
  }

  draw() {
    if (!this.scale) return;
    this.pixels();
    this.c.clearRect(0, 0, this.width, this.tall);
    this.metres();
    this.paint(this);
    this.drawScale();
  }

  // -- shapes, in metres

  disc(x, y, radius, fill, stroke) {
    this.c.beginPath();
    this.c.arc(x, y, radius, 0, 2 * Math.PI);
    this.finish(fill, stroke);
  }

  polygon(points, fill, stroke) {
    this.c.beginPath();
    for (const [x, y] of points) this.c.lineTo(x, y);
    this.c.closePath();
    this.finish(fill, stroke);
  }

  finish(fill, stroke) {
    if (fill) {
      this.c.fillStyle = fill;
      this.c.fill();
    }
    if (stroke) {
      this.c.strokeStyle = stroke;
      this.c.lineWidth = 2 / this.scale;
      this.c.stroke();
    }
  }

  line(points, stroke, width = 2, dash = []) {
    this.c.beginPath();
    for (const [x, y] of points) this.c.lineTo(x, y);
    this.c.strokeStyle = stroke;
    this.c.lineWidth = width / this.scale;
    this.c.lineJoin = "round";
    this.c.lineCap = this.c.globalAlpha < 1 ? "butt" : "round";
    this.c.setLineDash(dash.map(length => length / this.scale));
    this.c.stroke();
    this.c.setLineDash([]);
  }

  // Path [[x, y], ...] whose pieces are coloured by speeds [m/s], from 0 to `top`.
  trail(points, speeds, top, width = 4) {
    const shades = speedShades();
    for (let n = 1; n < points.length; n++) {
      const share = Math.min(Math.max(Math.abs(speeds[n]) / top, 0), 1);
      this.line([points[n - 1], points[n]], shades[Math.round(share * (shades.length - 1))], width);
    }
  }

  // Outline [[x, y], ...] of a robot at a pose, with a mark at its front.
  robot(outline, [x, y, yaw], fill, stroke) {
    const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
    const placed = outline.map(([a, b]) => [x + a * cos - b * sin, y + a * sin + b * cos]);
    this.polygon(placed, fill, stroke);
    const front = Math.max(...outline.map(point => point[0]));
    this.line(
      [
        [x, y],
        [x + front * cos, y + front * sin],
      ],
      color("paper"),
      2,
    );
  }

  start([x, y]) {
    this.disc(x, y, 5 / this.scale, color("goal"));
    this.label(x, y, "start");
  }

  goal([x, y], radius) {
    this.disc(x, y, Math.max(radius || 0, 6 / this.scale), null, color("goal"));
    this.disc(x, y, 2.5 / this.scale, color("goal"));
    this.label(x, y, "goal");
  }

  // Words beside a point, within the canvas.
  label(x, y, words) {
    const [left, top] = this.at(x, y);
    this.pixels();
    this.c.font = "600 13px sans-serif";
    const width = this.c.measureText(words).width;
    const isRight = left + 10 + width < this.width;
    const place = [
      isRight ? left + 8 : left - 8 - width,
      Math.min(Math.max(top - 10, 14), this.tall - 5),
    ];
    this.halo(words, ...place);
    this.metres();
  }

  halo(words, left, top) {
    this.c.lineWidth = 4;
    this.c.lineJoin = "round";
    this.c.strokeStyle = color("raised");
    this.c.strokeText(words, left, top);
    this.c.fillStyle = color("ink");
    this.c.fillText(words, left, top);
  }

  drawScale() {
    this.pixels();
    const length =
      [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50].find(metres => metres * this.scale >= 50) || 100;
    const words = `${length} m`;
    const [left, top] = [12, this.tall - 12];
    this.c.font = "13px sans-serif";
    // Obstacles behind it would make the words unreadable.
    const right = left + Math.max(length * this.scale, 6 + this.c.measureText(words).width);
    this.c.fillStyle = color("raised");
    this.c.globalAlpha = 0.85;
    this.c.fillRect(left - 6, top - 22, right - left + 12, 28);
    this.c.globalAlpha = 1;
    this.c.strokeStyle = color("ink");
    this.c.lineWidth = 2;
    this.c.lineCap = "butt";
    this.c.beginPath();
    for (const [x, y] of [
      [left, top - 5],
      [left, top],
      [left + length * this.scale, top],
      [left + length * this.scale, top - 5],
    ]) {
      this.c.lineTo(x, y);
    }
    this.c.stroke();
    this.halo(words, left + 6, top - 6);
  }
}

// 32 colours from standing to top speed, in the scheme of the page.
function speedShades() {
  const parse = name =>
    color(name)
      .match(/\w\w/g)
      .map(byte => parseInt(byte, 16));
  const [slow, fast] = [parse("slow"), parse("fast")];
  return Array.from({length: 32}, (_, n) => {
    const mixed = slow.map((byte, channel) => Math.round(byte + ((fast[channel] - byte) * n) / 31));
    return `rgb(${mixed.join(",")})`;
  });
}
