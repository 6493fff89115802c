// Page of drives: one map, one clock, speed and parameters over time. D is what page.py packs.
let world =
  D.worlds.find(one => `#${one.name}` === decodeURIComponent(location.hash)) || D.worlds[0];
let trial = 0;
const hidden = new Set(); // methods that are not shown
const isSingle = D.worlds.length === 1 && world.drives.length === 1;

for (const {drives, period} of D.worlds) drives.forEach(drive => unpack(drive, period));

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

function dashOf(drive) {
  return DASHES[D.methods[drive.m].color];
}

// Colour and dashes of a drive's lines. A single drive has the colour of its speed.
function lineOf(drive, drives) {
  if (drives.length === 1) return {color: "var(--fast)"};
  return {color: `var(--${colorOf(drive)})`, dash: dashOf(drive)};
}

function resultOf(drive) {
  return (drive.ok ? "reached the goal" : `failed: ${drive.why || "no goal"}`) + drive.hit;
}

// -- map ------------------------------------------------------------------------------------------

function paint(view) {
  paintWorld(view, world, clock.time);
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
    else view.line(points, color(colorOf(drive)), 2, dashOf(drive));
    view.c.globalAlpha = 1;
    const driven = [...points.slice(0, last + 1), pose.slice(0, 2)];
    const speeds = [...drive.speeds.slice(0, last + 1), drive.speeds[last]];
    if (isAlone) view.trail(driven, speeds, top);
    else view.line(driven, color(colorOf(drive)), 3, dashOf(drive));
    view.robot(D.outline, pose, isAlone ? color("brand") : color(colorOf(drive)), color("paper"));
    if (!drive.ok) cross(view, drive.poses[drive.poses.length - 1]);
  }
  paintCourse(view, world);
}

function cross(view, [x, y]) {
  const r = 7 / view.scale;
  for (const side of [r, -r]) {
    view.line(
      [
        [x - r, y - side],
        [x + r, y + side],
      ],
      color("bad"),
      3,
    );
  }
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
  viewOf(world),
  paint,
  "Map with obstacles, start, goal and the driven paths",
);
let charts = [];

function showWorld() {
  const drives = drivesNow();
  history.replaceState(null, "", `#${encodeURIComponent(world.name)}`);
  view.show(viewOf(world));
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

function methodSwatch({color: index}) {
  return swatchOf({swatch: "line", color: methodColor(index), dash: DASHES[index]});
}

// A method's line, and whether its drives are shown.
function methodBox(method, m) {
  const box = make("input", {type: "checkbox", checked: !hidden.has(m)});
  box.onchange = () => {
    if (box.checked) hidden.delete(m);
    else hidden.add(m);
    showWorld();
  };
  return make("li", {}, make("label", {}, box, methodSwatch(method), method.name));
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
      ...lineOf(drive, drives),
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

function showParameters(drives) {
  const decided = drives.filter(drive => drive.theta);
  if (!decided.length) return;
  const lines = decided.map(drive => lineOf(drive, decided));
  const options = {x: [0, endOf(drives)], onpick: goTo};
  charts.push(...parameterCharts(parameterBox, unchanged, D.parameters, decided, lines, options));
}

function showResults(drives) {
  results.hidden = world.drives.length < 2 && D.worlds.length < 2;
  const numbers = ["time [s]", "length [m]", "mean speed [m/s]"];
  const rows = drives.map(drive => {
    const cells = [fixed(drive.t, 1), fixed(drive.length, 1), fixed(drive.length / drive.t, 2)].map(
      words => make("td", {class: "number"}, words),
    );
    const method = D.methods[drive.m];
    const name = make("td", {}, make("span", {class: "named"}, methodSwatch(method), method.name));
    return make(
      "tr",
      {},
      name,
      make("td", {class: drive.ok ? null : "bad"}, resultOf(drive)),
      ...cells,
    );
  });
  const head = headOf(["method", "result", ...numbers], numbers);
  results.replaceChildren(make("table", {}, head, make("tbody", {}, ...rows)));
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
    unpack(drive, world.period);
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

document.addEventListener("keydown", event => {
  if (event.key !== " " || event.target.closest("button, select, input, summary, a")) return;
  event.preventDefault();
  clock.toggle();
});
clock.listeners.push(time => {
  view.draw();
  for (const {chart, words} of charts) chart.cursor(time, words(time));
});
showWorld();
if (isSingle && !reducedMotion.matches) clock.play();
