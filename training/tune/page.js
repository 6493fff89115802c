// Page of ./applr tune. D is what page.py packs: changes, verdicts with their courses, and how to
// load the set.
const BEFORE = "var(--method-0)";
const AFTER = "var(--method-2)";
const CHANGE_COLUMNS = "minmax(9rem, max-content) max-content minmax(7rem, 1fr) max-content";

const NARROW_PX = 640; // width of a page with room for few numbers on an axis

// -- what changed ---------------------------------------------------------------------------------

const saving = "without it [s]";
const [low, high] = [
  rangeOf([0, ...D.changes.map(row => row["95 % low"] ?? row[saving])])[0],
  rangeOf([1, ...D.changes.map(row => row["95 % high"] ?? row[saving])])[1],
];

// Place of a saving [%] on an axis of square roots, which shows small and large ones.
function place(seconds) {
  const root = value => Math.sign(value) * Math.sqrt(Math.abs(value));
  return (100 * (root(seconds) - root(low))) / (root(high) - root(low));
}

function dotOf(row) {
  const at = place(row[saving]);
  const fill = row.effect === "saves" ? "var(--goal)" : "var(--soft)";
  const svg = make(
    "svg",
    {role: "img", "aria-label": `${row.effect}, ${row[saving]} s`},
    make("line", {x1: `${place(0)}%`, x2: `${place(0)}%`, y1: -6, y2: 34, stroke: "var(--edge)"}),
  );
  if (row["95 % low"] !== null) {
    svg.append(
      make("line", {
        x1: `${place(row["95 % low"])}%`,
        x2: `${place(row["95 % high"])}%`,
        y1: 14,
        y2: 14,
        stroke: fill,
        "stroke-width": 2,
      }),
    );
  }
  // An unclear effect is hollow: colours alone do not tell everybody.
  const inside = row.effect === "saves" ? fill : "var(--paper)";
  const style = `fill: ${inside}; stroke: ${fill}; stroke-width: 2`;
  svg.append(make("circle", {cx: `${at}%`, cy: 14, r: 5, style}));
  return svg;
}

function changeRow(row) {
  const interval =
    row["95 % low"] === null ? "" : ` (${short(row["95 % low"])} to ${short(row["95 % high"])})`;
  const words = row.effect === "saves" ? "saves" : "unclear";
  return make(
    "div",
    {},
    make("span", {title: row.meaning}, make("b", {}, row.parameter)),
    make("span", {}, `${row.default} → ${row.tuned}`.replaceAll("-", "−")),
    dotOf(row),
    make("span", {class: "right"}, `${words}, ${short(row[saving])} s${interval}`),
  );
}

// Row below plots with the values [s] of an axis, each at its place [%].
function axisOf(values, place, emptyBefore) {
  const svg = make("svg", {"aria-hidden": "true"});
  let latest = -Infinity;
  for (const value of values) {
    const at = place(value);
    // Numbers would lie on one another.
    if (at - latest < 9) continue;
    latest = at;
    const style = "fill: var(--soft); font-size: 12px";
    const text = {x: `${at}%`, y: 16, "text-anchor": "middle", style};
    svg.append(make("text", text, `${fixed(value, 0)} s`));
  }
  const before = Array.from({length: emptyBefore}, () => make("span"));
  return make("div", {}, ...before, svg, make("span"));
}

const changes = [...D.changes].sort(
  (a, b) => (b.effect === "saves") - (a.effect === "saves") || b[saving] - a[saving],
);
const changeRows = make(
  "div",
  {class: "rows changes", style: `grid-template-columns: ${CHANGE_COLUMNS}`},
  ...changes.map(changeRow),
  axisOf(
    [-100, -10, 0, 1, 10, 30, 100, 300, 1000].filter(value => value >= low && value <= high),
    place,
    2,
  ),
);
content.append(
  make("h2", {}, "What changed"),
  changeRows,
  make(
    "p",
    {class: "note"},
    "Dots: by how much the cost of a course rises if only this parameter is reverted to its " +
      "default, with the 95 % interval, on an axis of square roots. Filled: the interval lies " +
      `above 0, the change saves something. The cost of a course is its time; ${D.rule}.`,
  ),
  make(
    "details",
    {},
    make("summary", {}, "What the parameters mean"),
    make(
      "ul",
      {},
      ...changes.map(row => make("li", {}, make("b", {}, row.parameter), `: ${row.meaning}`)),
    ),
  ),
);

// -- verdicts, course by course -------------------------------------------------------------------

function groupOf({before, after}) {
  if (before.ok && after.ok) return 0;
  if (after.ok) return 1;
  return before.ok ? 2 : 3;
}

const GROUPS = [
  "Both arrive",
  "Only the tuned set arrives",
  "It fails, the defaults arrive",
  "It fails, like the defaults",
];

function courseRow(course, longest, drives) {
  const svg = make("svg", {role: "img", "aria-label": `${course.world}: ${wordsOf(course)}`});
  const at = seconds => (100 * seconds) / longest;
  const {before, after} = course;
  if (before.ok && after.ok) {
    svg.append(
      make("line", {
        x1: `${at(before.t)}%`,
        x2: `${at(after.t)}%`,
        y1: 14,
        y2: 14,
        stroke: "var(--line)",
        "stroke-width": 2,
      }),
    );
  }
  if (before.ok)
    svg.append(
      make("circle", {
        cx: `${at(before.t)}%`,
        cy: 14,
        r: 4.5,
        style: `fill: var(--paper); stroke: ${BEFORE}; stroke-width: 2`,
      }),
    );
  if (after.ok)
    svg.append(make("circle", {cx: `${at(after.t)}%`, cy: 14, r: 5, style: `fill: ${AFTER}`}));
  const name = drives
    ? make("a", {href: `${drives}#${encodeURIComponent(course.world)}`}, course.world)
    : course.world;
  return make(
    "div",
    {},
    make("span", {}, name),
    svg,
    make("span", {class: after.ok ? null : "bad"}, wordsOf(course)),
  );
}

function wordsOf({before, after}) {
  const end = trial => (trial.ok ? `${fixed(trial.t, 1)} s` : "fails");
  // The first sentence of the planner's words says it.
  const reason = after.ok ? "" : `: ${after.why.split(". ")[0]}`;
  return `${end(before)} → ${end(after)}${reason}`;
}

// Title and rows of each group of courses.
function courseGroups({courses, drives}, longest) {
  const ticks = ticksOf(0, longest, innerWidth < NARROW_PX ? 2 : 5);
  const parts = [];
  GROUPS.forEach((title, group) => {
    const members = courses.filter(course => groupOf(course) === group);
    if (!members.length) return;
    members.sort((a, b) => b.before.t - b.after.t - (a.before.t - a.after.t));
    const rows = members.map(course => courseRow(course, longest, drives));
    // Where neither arrives, there are no times.
    if (members.some(course => course.before.ok || course.after.ok))
      rows.push(axisOf(ticks, seconds => (100 * seconds) / longest, 1));
    parts.push(
      make("h3", {}, `${title}: ${members.length}`),
      make("div", {class: "rows courses"}, ...rows),
    );
  });
  if (drives)
    parts.push(make("p", {class: "note"}, "A click on a course shows both drives in motion."));
  return parts;
}

function verdictSection(verdict) {
  const {courses} = verdict;
  const arrived = key => courses.filter(course => course[key].ok).length;
  const longest =
    1.05 *
    Math.max(
      ...courses
        .flatMap(course => [course.before, course.after])
        .filter(trial => trial.ok)
        .map(trial => trial.t),
      1,
    );
  const section = make(
    "section",
    {},
    make("h2", {}, `${verdict.file}, ${verdict.monitor} the collision monitor`),
  );
  section.append(
    make(
      "p",
      {},
      make(
        "b",
        {},
        `Arrives on ${arrived("after")} of ${courses.length} courses; `,
        `with the defaults on ${arrived("before")}.`,
      ),
      verdict.is_better
        ? " The file was written."
        : " Not clearly better, so that the file was not written to the robot.",
    ),
    legend([
      {swatch: "ring", color: BEFORE, words: "time with the defaults"},
      {color: AFTER, words: "time with the tuned set"},
    ]),
  );
  const rows = courseGroups(verdict, longest);
  if (verdict === D.verdicts[0]) section.append(...rows);
  else section.append(make("details", {}, make("summary", {}, "Course by course"), ...rows));
  return section;
}

content.append(...D.verdicts.map(verdictSection));

// -- how to load it -------------------------------------------------------------------------------

const [loaded, applied] = D.verdicts;
const isWritten = D.verdicts.some(verdict => verdict.is_better);
content.append(make("h2", {}, isWritten ? "How to load it" : "What to try next"));
// A set that is not clearly better is not recommended.
if (loaded.is_better)
  content.append(
    make("p", {}, `Any move_base loads ${loaded.file} after the robot's own files:`),
    make("pre", {tabindex: 0}, `<rosparam file="${loaded.path}" command="load" ns="move_base"/>`),
  );
if (applied.is_better)
  content.append(
    make(
      "p",
      {},
      `The applr node sets ${applied.file} while move_base runs, with the collision monitor:`,
    ),
    make("pre", {tabindex: 0}, `./applr demo robot:=${D.robot} method:=${applied.path}`),
  );
if (!isWritten) content.append(make("p", {}, D.next));
content.append(
  make("details", {}, make("summary", {}, loaded.file), make("pre", {tabindex: 0}, D.yaml)),
  make("h2", {}, "What it was tried for, and what not"),
  ...D.scope.split("\n").map(line => make("p", {}, `${line[0].toUpperCase()}${line.slice(1)}`)),
  make("p", {}, D.not_tried),
);
