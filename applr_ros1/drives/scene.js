// What the pages of drives and the report's profiles share: a world with its drives as page.py packs
// them, drawn on a map, and parameters over time.

// Poses [m, m, rad], speeds [m/s] and times [s] from differences in centimetres and hundredths of a
// radian.
function unpack(drive, period) {
  const sum = [0, 0, 0];
  drive.poses = drive.p.map(step => {
    step.forEach((value, n) => {
      sum[n] += value;
    });
    return sum.map(value => value / 100);
  });
  drive.speeds = drive.v.map(value => value / 100);
  drive.period = period;
  drive.times = drive.p.map((_, n) => n * period);
  drive.end = drive.times[drive.times.length - 1];
  drive.decided = (drive.at || []).map(time => time / 100);
  drive.length = 0;
  for (let n = 1; n < drive.poses.length; n++) {
    const [from, to] = [drive.poses[n - 1], drive.poses[n]];
    drive.length += Math.hypot(to[0] - from[0], to[1] - from[1]);
  }
}

function poseAt(drive, time) {
  const at = Math.min(time / drive.period, drive.poses.length - 1);
  const first = Math.floor(at);
  const from = drive.poses[first];
  const to = drive.poses[Math.min(first + 1, drive.poses.length - 1)];
  const share = at - first;
  const turn = Math.atan2(Math.sin(to[2] - from[2]), Math.cos(to[2] - from[2]));
  return [
    from[0] + share * (to[0] - from[0]),
    from[1] + share * (to[1] - from[1]),
    from[2] + share * turn,
  ];
}

// -- map ------------------------------------------------------------------------------------------

function viewOf(world) {
  return world.view.map(value => value / 100);
}

// Obstacles, with the moving ones as they are at a time [s].
function paintWorld(view, world, time) {
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
  for (const [radius, places] of world.movers) {
    const n = Math.min(Math.round(time / world.period), places.length - 1);
    const [from, to] = [places[n], places[n + 1] || places[n]];
    const step = to.map((value, axis) => (value - from[axis]) / 100 / world.period);
    const place = from.map(value => value / 100);
    paintMover(view, place, step, radius / 100, world.marked);
  }
}

// A moving obstacle, with its path in the next second at its present velocity [m/s], and its
// predicted discs where the planner knew them.
function paintMover(view, [x, y], [u, v], radius, isPredicted) {
  view.disc(x, y, radius, color("mover"));
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
  if (!isPredicted) return;
  for (const time of [0.3, 0.6, 0.9])
    view.disc(x + u * time, y + v * time, radius, null, color("mover"));
}

// Start, and goal or finish line.
function paintCourse(view, world) {
  const [left, , right] = viewOf(world);
  if (world.finish !== null) {
    const y = world.finish / 100;
    view.line(
      [
        [left, y],
        [right, y],
      ],
      color("goal"),
      2,
      [7, 6],
    );
    view.label((left + right) / 2, y, "finish line");
  } else {
    view.goal([world.goal[0] / 100, world.goal[1] / 100], world.goal[2] / 100);
  }
  view.start([world.start[0] / 100, world.start[1] / 100]);
}

// -- parameters -----------------------------------------------------------------------------------

// Charts of the parameters that change in some drives, those that change most first, with a cursor
// that says the values; the others are named in a sentence. lines: {color, dash} of each drive;
// options: those of Chart; hasDefaults: whether default values are drawn.
function parameterCharts(host, sentence, parameters, drives, lines, options, hasDefaults = false) {
  const changes = parameters.map((parameter, n) => {
    const amount = changeOf(n, drives) / (parameter.high - parameter.low || 1);
    return {parameter, n, amount};
  });
  changes.sort((a, b) => b.amount - a.amount);
  host.replaceChildren();
  const charts = [];
  const constant = [];
  for (const {parameter, n, amount} of changes) {
    if (amount > 1e-9) {
      const standard = hasDefaults ? [defaultLine(parameter, options.x)] : [];
      charts.push(parameterChart(host, parameter, n, drives, lines, {...options, lines: standard}));
    } else {
      const value = short(drives[0].theta[0][n]);
      constant.push(`${parameter.name} ${value} ${parameter.unit}`.trim());
    }
  }
  sentence.textContent = constant.length ? `Unchanged: ${constant.join(", ")}.` : "";
  return charts;
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

function defaultLine(parameter, times) {
  const points = times.map(time => [time, parameter.default]);
  return {color: "var(--soft)", dash: [3, 3], points};
}

function parameterChart(host, parameter, n, drives, lines, options) {
  const box = make("div");
  host.append(box);
  const driven = drives.map((drive, row) => ({
    ...lines[row],
    isStep: true,
    points: [
      ...drive.decided.map((time, decision) => [time, drive.theta[decision][n]]),
      [drive.end, drive.theta[drive.theta.length - 1][n]],
    ],
  }));
  const chart = new Chart(box, {
    title: parameter.name,
    height: 74,
    ticks: [0, 2],
    y: [parameter.low, parameter.high],
    hasEnds: true,
    ...options,
    lines: [...options.lines, ...driven],
  });
  const words = time => {
    const values = drives.map(drive => short(drive.theta[indexAt(drive.decided, time)][n]));
    return `${parameter.name}: ${values.join(" · ")} ${parameter.unit}`.trim();
  };
  return {chart, words};
}
