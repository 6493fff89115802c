// Page of drives: one map, one clock, speed and parameters over time. D is what page.py packs.
let world =
  D.worlds.find(one => `#${one.name}` === decodeURIComponent(location.hash)) || D.worlds[0];
let trial = 0;
const hidden = new Set(); // methods that are not shown
const isSingle = D.worlds.length === 1 && world.drives.length === 1;
const [length, width] = D.body;
const outline = [
  [length / 2, width / 2],
  [length / 2, -width / 2],
  [-length / 2, -width / 2],
  [-length / 2, width / 2],
];

for (const one of D.worlds) one.drives.forEach(unpack);

// Poses [m, m, rad], speeds [m/s] and times [s] from differences in centimetres and hundredths of a
// radian.
function unpack(drive) {
  const sum = [0, 0, 0];
  drive.poses = drive.p.map(step => {
    step.forEach((value, n) => {
      sum[n] += value;
    });
    return sum.map(value => value / 100);
  });
  drive.speeds = drive.v.map(value => value / 100);
  drive.times = drive.p.map((_, n) => n * D.period);
  drive.end = drive.times[drive.times.length - 1];
  drive.decided = (drive.at || []).map(time => time / 100);
  drive.length = drive.poses.reduce(
    (way, pose, n, all) =>
      n ? way + Math.hypot(pose[0] - all[n - 1][0], pose[1] - all[n - 1][1]) : 0,
    0,
  );
}

function drivesNow() {
  return world.drives.filter(drive => drive.k === trial && !hidden.has(drive.m));
}

// Time at which the last of some drives ends [s].
function endOf(drives) {
  return Math.max(0.1, ...drives.map(drive => drive.end));
}

function goTo(time) {
  clock.pause();
  clock.set(time);
}

function colorOf(drive) {
  return `method-${D.methods[drive.m].color}`;
}

function poseAt(drive, time) {
  const at = Math.min(time / D.period, drive.poses.length - 1);
  const first = Math.floor(at);
  const a = drive.poses[first];
  const b = drive.poses[Math.min(first + 1, drive.poses.length - 1)];
  const share = at - first;
  const turn = Math.atan2(Math.sin(b[2] - a[2]), Math.cos(b[2] - a[2]));
  return [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * turn];
}

function resultOf(drive) {
  const touched = drive.hit ? ", touched something" : "";
  return (drive.ok ? "reached the goal" : `failed: ${drive.why || "no goal"}`) + touched;
}

// -- map ------------------------------------------------------------------------------------------

function paint(view) {
  paintWorld(view);
  const drives = drivesNow();
  const isAlone = drives.length === 1;
  const top = topSpeed();
  const isUntouched = clock.time === 0 && !clock.isPlaying;
  for (const drive of drives) {
    const last = indexAt(drive.times, clock.time);
    const points = drive.poses.map(pose => [pose[0], pose[1]]);
    const pose = poseAt(drive, clock.time);
    view.c.globalAlpha = isUntouched ? 1 : 0.35;
    if (isAlone) view.trail(points, drive.speeds, top);
    else view.line(points, color(colorOf(drive)));
    view.c.globalAlpha = 1;
    const driven = [...points.slice(0, last + 1), pose.slice(0, 2)];
    const speeds = [...drive.speeds.slice(0, last + 1), drive.speeds[last]];
    if (isAlone) view.trail(driven, speeds, top);
    else view.line(driven, color(colorOf(drive)), 3);
    view.robot(outline, pose, isAlone ? color("brand") : color(colorOf(drive)), color("paper"));
    if (!drive.ok) cross(view, drive.poses[drive.poses.length - 1]);
  }
  paintCourse(view);
}

function cross(view, [x, y]) {
  const r = 7 / view.scale;
  view.line(
    [
      [x - r, y - r],
      [x + r, y + r],
    ],
    color("bad"),
    3,
  );
  view.line(
    [
      [x - r, y + r],
      [x + r, y - r],
    ],
    color("bad"),
    3,
  );
}

function paintWorld(view) {
  const fill = color("obstacle");
  for (const [x, y, r] of world.circles) view.disc(x / 1000, y / 1000, r / 1000, fill);
  for (const [x, y, yaw, a, b] of world.boxes) {
    view.c.save();
    view.c.translate(x / 100, y / 100);
    view.c.rotate(yaw / 100);
    view.c.fillStyle = fill;
    view.c.fillRect(-a / 200, -b / 200, a / 100, b / 100);
    view.c.restore();
  }
  for (const [radius, places] of world.movers) paintMover(view, radius / 100, places);
}

function paintCourse(view) {
  const [left, , right] = world.view.map(value => value / 100);
  if (world.finish !== null) {
    view.line(
      [
        [left, world.finish / 100],
        [right, world.finish / 100],
      ],
      color("goal"),
      2,
      [7, 6],
    );
    view.label((left + right) / 2, world.finish / 100, "finish line");
  } else {
    view.goal([world.goal[0] / 100, world.goal[1] / 100], world.goal[2] / 100);
  }
  view.start([world.start[0] / 100, world.start[1] / 100]);
}

// A moving obstacle, with its path in the next second at its present speed, and its predicted
// discs.
function paintMover(view, radius, places) {
  const n = Math.min(Math.round(clock.time / D.period), places.length - 1);
  const [x, y] = places[n].map(value => value / 100);
  view.disc(x, y, radius, color("mover"));
  if (n + 1 >= places.length) return;
  const [u, v] = places[n + 1].map((value, axis) => (value - places[n][axis]) / 100 / D.period);
  const speed = Math.hypot(u, v);
  // It stands, or starts again elsewhere.
  if (speed < 0.05 || speed > 10) return;
  view.line(
    [
      [x, y],
      [x + u, y + v],
    ],
    color("mover"),
    2,
  );
  if (D.marked)
    for (const time of [0.3, 0.6, 0.9])
      view.disc(x + u * time, y + v * time, radius, null, color("mover"));
}

function topSpeed() {
  return Math.max(0.1, ...world.drives.map(drive => rangeOf(drive.speeds)[1]));
}

// -- parts of the page ----------------------------------------------------------------------------

const RATES = [1, 2, 4, 10];
const PLAYED_S = 10; // time in which a drive is played at first, at most, if a rate allows it [s]
const clock = new Clock(1, RATES);
const strip = make("div", {class: "strip", role: "img"});
const figure = make("figure");
const notes = make("div");
const speedBox = make("div");
const parameterBox = make("div", {class: "small"});
const unchanged = make("p", {class: "note"});
const results = make("div", {class: "wide", tabindex: 0});
const choice = make("div", {class: "controls"});
content.append(choice, strip, figure, notes, clock.controls, speedBox, results);
if (D.parameters.length && D.worlds.some(one => one.drives.some(drive => drive.theta))) {
  content.append(make("h2", {}, "Parameters over time"), parameterBox, unchanged);
}
const view = new TopView(
  figure,
  world.view.map(value => value / 100),
  paint,
  "Map with obstacles, start, goal and the driven paths",
);
let charts = [];

function showWorld() {
  const drives = drivesNow();
  history.replaceState(null, "", `#${encodeURIComponent(world.name)}`);
  view.show(world.view.map(value => value / 100));
  notes.replaceChildren(legendNow(drives));
  charts = [];
  showSpeeds(drives);
  showParameters(drives);
  showResults(drives);
  showStrip();
  const end = endOf(drives);
  clock.rate.value = RATES.find(rate => end / rate <= PLAYED_S) || RATES[RATES.length - 1];
  clock.restart(end);
}

function legendNow(drives) {
  const entries = [];
  if (drives.length === 1)
    entries.push({
      swatch: "line scale",
      words: `driven path, standing to ${fixed(topSpeed(), 1)} m/s`,
    });
  entries.push({swatch: "square", color: "var(--obstacle)", words: "obstacle"});
  if (world.movers.length)
    entries.push({
      color: "var(--mover)",
      words: "moving obstacle, with its path in the next second",
    });
  const list = legend(entries);
  if (D.methods.length > 1) list.prepend(...D.methods.map(methodBox));
  return list;
}

// A method's colour, and whether its drives are shown.
function methodBox(method, m) {
  const box = make("input", {type: "checkbox", checked: !hidden.has(m)});
  box.onchange = () => {
    if (box.checked) hidden.delete(m);
    else hidden.add(m);
    showWorld();
  };
  const swatch = make("span", {
    class: "swatch line",
    style: `--swatch: ${methodColor(method.color)}`,
  });
  return make("li", {}, make("label", {}, box, swatch, method.name));
}

function showSpeeds(drives) {
  const [low, high] = rangeOf([0, topSpeed(), ...drives.flatMap(drive => drive.speeds)]);
  const isAlone = drives.length === 1;
  const chart = {
    title: "Speed [m/s]",
    xTitle: "time [s]",
    height: 190,
    x: [0, endOf(drives)],
    y: [low, 1.05 * high],
    lines: drives.map(drive => ({
      color: isAlone ? "var(--fast)" : `var(--${colorOf(drive)})`,
      points: drive.times.map((time, n) => [time, drive.speeds[n]]),
    })),
    marks: isAlone ? drives[0].decided.map(x => ({x})) : [],
    onpick: goTo,
  };
  speedBox.replaceChildren();
  const made = new Chart(speedBox, chart);
  const words = time => {
    if (!isAlone) return "Speed [m/s]";
    const row = indexAt(drives[0].times, time);
    return `Speed [m/s]: ${fixed(drives[0].speeds[row], 2)}`;
  };
  charts.push({chart: made, words});
  if (isAlone && drives[0].decided.length)
    speedBox.append(make("p", {class: "note"}, "Ticks on the time axis: decisions of the method."));
}

// A line for each parameter that changes, those that change most first.
function showParameters(drives) {
  const decided = drives.filter(drive => drive.theta);
  const end = endOf(drives);
  const changes = D.parameters.map((parameter, n) => ({
    parameter,
    n,
    amount: changeOf(n, decided) / (parameter.high - parameter.low || 1),
  }));
  changes.sort((a, b) => b.amount - a.amount);
  parameterBox.replaceChildren();
  const constant = [];
  for (const {parameter, n, amount} of decided.length ? changes : []) {
    if (amount > 1e-9) {
      addParameter(parameter, n, decided, end);
    } else {
      const value = short(decided[0].theta[0][n]);
      constant.push(`${parameter.name} ${value} ${parameter.unit}`.trim());
    }
  }
  unchanged.textContent = constant.length ? `Unchanged: ${constant.join(", ")}.` : "";
}

// How much the n-th parameter changes in some drives, and differs between their beginnings.
function changeOf(n, drives) {
  let sum = 0;
  for (const {theta} of drives) {
    for (let row = 1; row < theta.length; row++) {
      sum += Math.abs(theta[row][n] - theta[row - 1][n]);
    }
  }
  const [least, most] = rangeOf(drives.map(drive => drive.theta[0][n]));
  return sum + most - least;
}

function addParameter(parameter, n, drives, end) {
  const isAlone = drives.length === 1;
  const unit = parameter.unit ? ` ${parameter.unit}` : "";
  const box = make("div");
  parameterBox.append(box);
  const chart = new Chart(box, {
    title: parameter.name,
    height: 74,
    ticks: [0, 2],
    x: [0, end],
    y: [parameter.low, parameter.high],
    hasEnds: true,
    lines: drives.map(drive => ({
      color: isAlone ? "var(--fast)" : `var(--${colorOf(drive)})`,
      isStep: true,
      points: [
        ...drive.decided.map((time, row) => [time, drive.theta[row][n]]),
        [drive.end, drive.theta[drive.theta.length - 1][n]],
      ],
    })),
    onpick: goTo,
  });
  const words = time => {
    const values = drives.map(drive => short(drive.theta[indexAt(drive.decided, time)][n]));
    return `${parameter.name}: ${values.join(" · ")}${unit}`;
  };
  charts.push({chart, words});
}

function showResults(drives) {
  results.hidden = world.drives.length < 2 && D.worlds.length < 2;
  const head = ["method", "result", "time [s]", "length [m]", "mean speed [m/s]"].map(words =>
    make("th", {scope: "col", style: words === "result" ? "text-align: left" : null}, words),
  );
  const rows = drives.map(drive => {
    const cells = [fixed(drive.t, 1), fixed(drive.length, 1), fixed(drive.length / drive.t, 2)].map(
      words => make("td", {}, words),
    );
    const name = make(
      "td",
      {},
      make("span", {
        class: "swatch line",
        style: `--swatch: var(--${colorOf(drive)}); display: inline-block; margin: 0 .5rem .2rem 0`,
      }),
      D.methods[drive.m].name,
    );
    return make(
      "tr",
      {},
      name,
      make("td", {class: drive.ok ? null : "bad", style: "text-align: left"}, resultOf(drive)),
      ...cells,
    );
  });
  results.replaceChildren(
    make("table", {}, make("thead", {}, make("tr", {}, ...head)), make("tbody", {}, ...rows)),
  );
}

// -- choice of a world ----------------------------------------------------------------------------

const worldSelect = make("select", {"aria-label": "World"});
D.worlds.forEach((one, n) => worldSelect.append(make("option", {value: n}, one.name)));
worldSelect.onchange = () => {
  world = D.worlds[worldSelect.value];
  showWorld();
};
const trials = [...new Set(D.worlds.flatMap(one => one.drives.map(drive => drive.k)))].sort(
  (a, b) => a - b,
);
trial = trials[0];
const trialSelect = make("select", {"aria-label": "Trial"});
trials.forEach(k => trialSelect.append(make("option", {value: k}, `trial ${k}`)));
trialSelect.onchange = () => {
  trial = Number(trialSelect.value);
  showWorld();
};

function step(count) {
  const n = (D.worlds.indexOf(world) + count + D.worlds.length) % D.worlds.length;
  world = D.worlds[n];
  worldSelect.value = n;
  showWorld();
}

if (D.worlds.length > 1) {
  choice.append(
    make("button", {type: "button", onclick: () => step(-1)}, "Previous world"),
    worldSelect,
    make("button", {type: "button", onclick: () => step(1)}, "Next world"),
  );
}
if (trials.length > 1) choice.append(trialSelect);

// A row of bars for each method, a bar for each world: its height grows with the square root of the
// time, so that short
// times differ beside a long one. A failure is a full bar in another colour.
function showStrip() {
  strip.hidden = D.worlds.length < 2;
  if (strip.hidden) return;
  const longest = Math.max(
    ...D.worlds.flatMap(one => one.drives.filter(drive => drive.ok).map(drive => drive.t)),
    1,
  );
  strip.setAttribute(
    "aria-label",
    "Times of all methods in all worlds; the worlds can also be chosen above",
  );
  strip.replaceChildren();
  D.methods.forEach((method, m) => {
    const row = make("div", {class: "bars"});
    D.worlds.forEach((one, n) => {
      const drive = one.drives.find(each => each.m === m && each.k === trial);
      const isFailed = drive && !drive.ok;
      const time = drive ? drive.t : 0;
      const share = isFailed ? 100 : 100 * Math.sqrt(time / longest);
      const shade = isFailed ? "var(--bad)" : methodColor(method.color);
      const result = drive ? `${resultOf(drive)}, ${fixed(drive.t, 1)} s` : "not recorded";
      const title = `${one.name}, ${method.name}: ${result}`;
      const bar = make(
        "i",
        {title, class: one === world ? "now" : null},
        make("b", {style: `height: ${share}%; background: ${shade}`}),
      );
      bar.onclick = () => step(n - D.worlds.indexOf(world));
      row.append(bar);
    });
    strip.append(make("span", {}, method.name), row);
  });
  worldSelect.value = D.worlds.indexOf(world);
}

// -- another drive in the same world --------------------------------------------------------------

const message = make("span", {class: "note", role: "status"});

// Add the drive of another page of a single drive.
async function compare(file) {
  const page = new DOMParser()
    .parseFromString(await file.text(), "text/html")
    .getElementById("data");
  const other = page ? JSON.parse(page.textContent) : {};
  if (!other.worlds || other.worlds[0].name !== world.name) {
    const remedy = `give a page of ./applr demo world:=${world.name}`;
    message.textContent = `${file.name} has no drive in ${world.name}: ${remedy}`;
    return;
  }
  const used = D.methods.map(method => method.color);
  const names = JSON.stringify(D.parameters.map(parameter => parameter.name));
  const isSameSpace = JSON.stringify(other.parameters.map(parameter => parameter.name)) === names;
  for (const drive of other.worlds[0].drives) {
    const {name, color} = other.methods[drive.m];
    const free = [color, 0, 1, 2, 3, 4, 5].find(index => !used.includes(index)) ?? color;
    drive.m =
      D.methods.push({name: used.includes(color) ? `${name}, ${file.name}` : name, color: free}) -
      1;
    if (!isSameSpace) delete drive.theta;
    drive.k = trial;
    unpack(drive);
    world.drives.push(drive);
  }
  message.textContent = "";
  showWorld();
}

if (isSingle) {
  const input = make("input", {
    type: "file",
    accept: ".html",
    class: "unseen",
    onchange: () => compare(input.files[0]),
  });
  content.append(
    make(
      "div",
      {class: "controls"},
      make("label", {class: "button"}, input, "Compare with the page of another drive"),
      message,
    ),
  );
}

clock.listeners.push(time => {
  view.draw();
  for (const {chart, words} of charts) chart.cursor(time, words(time));
});
showWorld();
if (isSingle && !reducedMotion.matches) clock.play();
