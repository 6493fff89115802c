// Page of ./applr why: the answer, the whole drive, one of its events, and what was tried. D is
// Answer.values() of answer.py.
const PLAN_DASH = [6, 5]; // dashes of a plan [px]
const AROUND_M = 2.5; // half of the side of the map of a moment
// Words of the command with the arrows of the page.
function readable(words) {
  return words.replaceAll(" -> ", " → ").replaceAll(" -0.", " −0.");
}

const footprint = D.footprint;
const times = D.track.map(row => row[0]);
const positions = D.track.map(row => [row[1], row[2]]);
const speeds = D.track.map(row => row[3]);
const whole = boxAround(D.goal ? [...positions, D.goal] : positions);
let event = D.events.indexOf(
  D.events.reduce((a, b) => (b.end - b.begin > a.end - a.begin ? b : a), D.events[0]),
);
// A link of a logbook ends with the number of the event.
const linked = Number(location.hash.slice(1)) - 1;
if (D.events[linked]) event = linked;
let moment = 0;

// The part of the plane that has the path and the goal, and what the laser saw near them.
function boxAround(path) {
  const [left, right] = rangeOf(path.map(point => point[0]));
  const [low, high] = rangeOf(path.map(point => point[1]));
  const near = D.map.filter(
    ([x, y]) => x > left - 3 && x < right + 3 && y > low - 1.5 && y < high + 1.5,
  );
  const [leftmost, rightmost] = rangeOf([left, right, ...near.map(point => point[0])]);
  const [lowest, highest] = rangeOf([low, high, ...near.map(point => point[1])]);
  return [leftmost - 0.2, lowest - 0.3, rightmost + 0.2, highest + 0.3];
}

function paintMap(view) {
  const size = Math.max(0.05, 2 / view.scale);
  view.c.fillStyle = color("obstacle");
  for (const [x, y] of D.map) view.c.fillRect(x - size / 2, y - size / 2, size, size);
}

function paintEnds(view) {
  view.start(positions[0]);
  if (D.goal) view.goal(D.goal, 0);
}

// -- the whole drive ------------------------------------------------------------------------------

function paintDrive(view) {
  paintMap(view);
  view.line(D.plan, color("soft"), 1.5, PLAN_DASH);
  view.trail(positions, speeds, D.top_speed);
  paintEnds(view);
  placeMarks(view);
}

function placeMarks(view) {
  placeMarksBeside(
    view,
    D.events.map(one => one.place),
    marks,
  );
}

function eventButton(n) {
  const one = D.events[n];
  return make(
    "button",
    {
      type: "button",
      class: "mark",
      title: one.title,
      "aria-label": `Event ${n + 1}: ${one.title}`,
      onclick: () => select(n),
    },
    String(n + 1),
  );
}

const marks = D.events.map((_, n) => eventButton(n));
const bandMarks = D.events.map((_, n) => eventButton(n));
const overview = make("figure");
content.append(
  ...D.advice.map(line => make("p", {class: "advice"}, readable(line))),
  make("h2", {}, "The drive"),
  overview,
);
const drive = new TopView(
  overview,
  whole,
  paintDrive,
  "Map of the scans with the plan, the driven path, and the events",
);
drive.element.append(...marks);
overview.append(
  legend([
    {swatch: "line scale", words: `driven path, standing to ${short(D.top_speed)} m/s`},
    {dash: PLAN_DASH, color: "var(--soft)", words: "first plan"},
    {swatch: "square", color: "var(--obstacle)", words: "seen by the laser"},
    {color: "var(--ink)", words: "event"},
  ]),
);
const [lowest, highest] = rangeOf([0, D.top_speed, ...speeds]);
const bands = make("div", {class: "bands"});
content.append(bands);
const speedChart = new Chart(bands, {
  title: "Speed [m/s]",
  xTitle: "time [s]",
  height: 200,
  x: [times[0], times[times.length - 1]],
  y: [lowest, 1.05 * highest],
  bands: D.events.map(one => [one.begin, one.end]),
  lines: [
    {
      color: "var(--line)",
      dash: [4, 4],
      points: [
        [times[0], D.top_speed],
        [times[times.length - 1], D.top_speed],
      ],
    },
    {color: "var(--fast)", points: D.track.map(row => [row[0], row[3]])},
  ],
  onpick: D.events.length ? selectAt : undefined,
  ondraw: placeBandMarks,
});
bands.append(...bandMarks);
content.append(
  make(
    "p",
    {class: "note"},
    "Shaded: events. Dashed: top speed of the planner. A click on an event shows its reason.",
  ),
);

function placeBandMarks() {
  let left = -Infinity;
  D.events.forEach((one, n) => {
    left = Math.max(left + MARK_PX, speedChart.px((one.begin + one.end) / 2));
    bandMarks[n].style.left = `${left}px`;
    bandMarks[n].style.top = `${speedChart.top + 4}px`;
  });
}

// -- an event -------------------------------------------------------------------------------------

const eventTitle = make("h2");
const eventReason = make("p");
const momentSlider = make("input", {
  type: "range",
  min: 0,
  step: 1,
  "aria-label": "Moment of the event",
  oninput: () => show(Number(momentSlider.value)),
});
const momentTime = make("output");
const momentRow = make(
  "div",
  {class: "controls"},
  make("span", {}, "Moment"),
  momentSlider,
  momentTime,
);
const detail = make("figure");
const costs = make("div");
const eventSection = make(
  "section",
  {},
  eventTitle,
  eventReason,
  momentRow,
  make("div", {class: "two"}, detail, costs),
);
if (D.events.length) content.append(eventSection);
const close = new TopView(
  detail,
  [0, 0, 1, 1],
  paintMoment,
  "Map of the moment with the trajectories of the planner by cost",
  () => 440,
);
detail.append(
  legend([
    {swatch: "line costs", words: "trajectories, cheap to dear"},
    {swatch: "ring", color: "var(--bad)", words: "obstacle in the way"},
    {dash: PLAN_DASH, color: "var(--soft)", words: "plan"},
  ]),
);

function cycleOf() {
  return D.events[event]?.cycles[moment];
}

function paintMoment(view) {
  const cycle = cycleOf();
  if (!cycle) return;
  paintMap(view);
  view.line(cycle.plan, color("soft"), 1.5, PLAN_DASH);
  const [low, high] = rangeOf(cycle.points.map(point => point[2]));
  // The cheap ones are drawn last, over the dear ones.
  for (const [x, y, cost] of [...cycle.points].sort((a, b) => b[2] - a[2])) {
    view.c.globalAlpha = 1;
    const share = (cost - low) / (high - low || 1);
    view.disc(
      x,
      y,
      2 / view.scale,
      `color-mix(in srgb, ${color("dear")} ${Math.round(100 * share ** 0.5)}%, ${color("cheap")})`,
    );
  }
  view.robot(footprint, cycle.pose, color("brand"));
  if (cycle.obstacle) view.disc(...cycle.obstacle, 9 / view.scale, null, color("bad"));
}

function select(n, at) {
  event = n;
  const chosen = D.events[n];
  momentSlider.max = chosen.cycles.length - 1;
  show(at === undefined ? chosen.cycles.length >> 1 : at);
}

function selectAt(time) {
  const distance = one => Math.max(one.begin - time, time - one.end, 0);
  const nearest = D.events.reduce(
    (best, one, n) => (distance(one) < distance(D.events[best]) ? n : best),
    0,
  );
  const offsets = D.events[nearest].cycles.map(cycle => Math.abs(cycle.at - time));
  select(nearest, Math.max(offsets.indexOf(Math.min(...offsets)), 0));
}

function show(n) {
  moment = n;
  const chosen = D.events[event];
  const cycle = cycleOf();
  [...marks, ...bandMarks].forEach((mark, row) =>
    mark.setAttribute("aria-pressed", row % D.events.length === event),
  );
  eventTitle.textContent = `Event ${event + 1}: ${chosen.title}`;
  const because = chosen.is_guessed ? "Perhaps because" : "Because";
  eventReason.textContent = chosen.reason ? `${because} ${chosen.reason}.` : "";
  momentRow.hidden = chosen.cycles.length < 2;
  detail.hidden = costs.hidden = !cycle;
  if (!cycle) return;
  momentSlider.value = n;
  momentTime.textContent = `at ${fixed(cycle.at, 1)} s`;
  momentSlider.setAttribute("aria-valuetext", momentTime.textContent);
  speedChart.cursor(cycle.at);
  const [x, y] = cycle.pose;
  close.show([x - AROUND_M, y - AROUND_M, x + AROUND_M, y + AROUND_M]);
  costs.replaceChildren(
    make("h3", {}, "What the planner weighed"),
    ...cycle.lines.map(line => make("p", {}, readable(line))),
    costBars(cycle),
    sampleTable(cycle),
  );
}

// Costs of the command and of the cheapest sample that drives on, a bar each, made of the critics'
// parts.
function costBars(cycle) {
  const [head, ...rows] = cycle.table;
  const critics = head.slice(3);
  const compared = [["command", rows[0]]];
  if (cycle.driving)
    compared.push([cycle.driving > 1 ? "driving on" : "", rows[cycle.driving - 1]]);
  const bars = compared.filter(([words]) => words);
  const most = Math.max(...bars.map(([, row]) => row[2]), 1e-9);
  const used = critics.filter((_, n) => bars.some(([, row]) => row[3 + n] > 0));
  const grid = make("div", {
    class: "rows",
    style: "grid-template-columns: max-content 1fr max-content",
  });
  for (const [words, row] of bars) {
    if (row[2] < 0) {
      grid.append(
        make(
          "div",
          {},
          sampleName(words, row),
          make("span", {}, "not compared, because the planner escapes"),
          make("span"),
        ),
      );
      continue;
    }
    const svg = make("svg", {role: "img", "aria-label": `${words}: cost ${short(row[2])}`});
    let left = 0;
    critics.forEach((name, n) => {
      if (row[3 + n] <= 0) return;
      const width = (100 * row[3 + n]) / most;
      svg.append(
        make(
          "rect",
          {
            x: `${left}%`,
            width: `${width}%`,
            y: 3,
            height: 20,
            fill: `var(--part-${used.indexOf(name) % 7})`,
          },
          make("title", {}, `${name}: ${short(row[3 + n])}`),
        ),
      );
      left += width;
    });
    grid.append(
      make("div", {}, sampleName(words, row), svg, make("span", {class: "right"}, short(row[2]))),
    );
  }
  const parts = used.map((name, n) => ({
    swatch: "square",
    color: `var(--part-${n % 7})`,
    words: name,
  }));
  const missing = cycle.driving ? null : make("p", {class: "note"}, "No faster sample is legal.");
  return make("div", {}, grid, missing, legend(parts));
}

function sampleName(words, row) {
  return make(
    "span",
    {},
    make("b", {}, words),
    make("br"),
    `${fixed(row[0], 2)} m/s, ${fixed(row[1], 2)} rad/s`,
  );
}

function sampleTable(cycle) {
  const [head, ...rows] = cycle.table;
  const cell = value => make("td", {class: "number"}, fixed(value, 2));
  const words = row => make("tr", {}, ...row.map(cell));
  return make(
    "details",
    {},
    make("summary", {}, "Samples in numbers"),
    make("p", {class: "note"}, "First the command, then the cheapest samples."),
    wideTable(head, make("tbody", {}, ...rows.map(words)), {}, head),
  );
}

// -- what was tried -------------------------------------------------------------------------------

const tried = D.recorded ? [D.recorded, ...D.tried] : [];
const shown = new Set(tried.length ? [0, 1] : []);

// Colours and dashes of methods, of which there are six. The first of both is that of the recorded
// values alone. The others go through all their pairs before one comes again.
const PAIRED = DASHES.length - 1;

function tryColor(n) {
  return `method-${n === 0 ? 0 : 1 + ((n - 1) % PAIRED)}`;
}

function tryDash(n) {
  if (n === 0) return DASHES[0];
  const round = Math.floor((n - 1) / PAIRED);
  return DASHES[1 + ((n - 1 + round) % PAIRED)];
}

function paintTried(view) {
  paintMap(view);
  tried.forEach((one, n) => {
    if (!shown.has(n)) return;
    for (const path of one.paths)
      view.line(
        path.map(row => [row[1], row[2]]),
        color(tryColor(n)),
        2.5,
        tryDash(n),
      );
  });
  paintEnds(view);
}

function triedRow(one, n) {
  const box = make("input", {type: "checkbox", checked: shown.has(n)});
  box.onchange = () => {
    if (box.checked) shown.add(n);
    else shown.delete(n);
    triedView.draw();
  };
  const label = make(
    "label",
    {class: "named"},
    box,
    swatchOf({swatch: "line", color: `var(--${tryColor(n)})`, dash: tryDash(n)}),
    readable(one.words),
  );
  return make("tr", {}, make("td", {}, label), make("td", {}, one.result));
}

let triedView = null;
if (tried.length) {
  const figure = make("figure");
  const rows = make("tbody", {}, ...tried.map(triedRow));
  const heads = ["values", "driven in simulation, from the recorded start to the goal"];
  content.append(
    make("h2", {}, "What was tried"),
    wideTable(heads, rows, {class: "words"}),
    figure,
  );
  triedView = new TopView(
    figure,
    whole,
    paintTried,
    "Map with the paths that were driven in simulation",
  );
  figure.append(
    make("figcaption", {}, "Paths that were driven in simulation, with the ticked values."),
  );
}
if (D.alternatives.length) {
  content.append(
    make(
      "details",
      // Whole drives say more than guesses.
      {open: !tried.length},
      make("summary", {}, "Guesses of the replay"),
      make("ul", {}, ...D.alternatives.map(line => make("li", {}, readable(line)))),
    ),
  );
}
content.append(
  make(
    "details",
    {},
    make("summary", {}, "The answer in text"),
    make("pre", {tabindex: 0}, D.lines.join("\n")),
  ),
);
if (D.events.length) select(event);
