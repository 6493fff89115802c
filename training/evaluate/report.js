// The report's figures: mean times against world index, and the parameter profiles, as in the paper.
// D is what report.py packs.
const host = document.getElementById("times");
const methods = Object.keys(D.methods);

// Ends of the least-squares line through points [[x, y], ...].
function fitOf(points) {
  const count = points.length;
  const meanX = points.reduce((sum, [x]) => sum + x, 0) / count;
  const meanY = points.reduce((sum, [, y]) => sum + y, 0) / count;
  const covariance = points.reduce((sum, [x, y]) => sum + (x - meanX) * (y - meanY), 0);
  const variance = points.reduce((sum, [x]) => sum + (x - meanX) ** 2, 0);
  const [low, high] = rangeOf(points.map(([x]) => x));
  return [low, high].map(x => [x, meanY + (covariance / variance) * (x - meanX)]);
}

function pointsOf(group, method) {
  return group.times[method].map((time, n) => [n, time]).filter(([, time]) => time !== null);
}

// Colour and outline of a method's dots.
function styleOf(method) {
  const index = D.methods[method];
  return {color: methodColor(index), outline: DOTS[index]};
}

function showGroup(group) {
  const series = methods.map(method => ({
    ...styleOf(method),
    points: pointsOf(group, method),
  }));
  const last = group.worlds.length - 1;
  const slider = make("input", {
    type: "range",
    min: 0,
    max: last,
    step: 1,
    value: 0,
    "aria-label": `World of the group ${group.name}`,
  });
  const words = make("p", {class: "note", "aria-live": "polite"});
  const box = make("figure");
  host.append(box);
  const chart = new Chart(box, {
    title: `${group.name} worlds: mean time of successful trials [s]`,
    xTitle: `world, in the order of ${D.baseline}'s mean time`,
    height: 330,
    whole: true,
    x: [-0.5, last + 0.5],
    y: [0, 1.05 * rangeOf(series.flatMap(one => one.points.map(([, time]) => time)))[1]],
    dots: series,
    lines: series
      .filter(one => one.points.length > 2)
      .map(one => ({color: one.color, dash: [5, 4], points: fitOf(one.points)})),
    onpick: x => pick(Math.min(Math.max(Math.round(x), 0), last)),
    onhover: true,
  });

  function pick(n) {
    const world = group.worlds[n];
    const times = methods.map(method => {
      const time = group.times[method][n];
      return time === null ? `${method} never arrives` : `${method} ${fixed(time, 1)} s`;
    });
    slider.value = n;
    slider.setAttribute("aria-valuetext", world);
    chart.cursor(n);
    const name = D.drives
      ? make("a", {href: `${D.drives}#${encodeURIComponent(world)}`}, world)
      : world;
    words.replaceChildren(name, `: ${times.join(", ")}`);
  }

  slider.oninput = () => pick(Number(slider.value));
  box.append(make("div", {class: "controls"}, make("span", {}, "World"), slider), words);
  pick(0);
}

if (D.groups.length) {
  const entries = methods.map(method => {
    const {color: shade, outline} = styleOf(method);
    return {color: shade, dot: outline, words: method};
  });
  host.append(make("h2", {}, "Time against world"), legend(entries));
  D.groups.forEach(showGroup);
  host.append(
    make(
      "p",
      {class: "note"},
      "A dot is the mean time of a method's successful trials in one world; a pointer or the slider " +
        "says which. Dashed: linear fits. This is the paper's figure of its environments.",
    ),
  );
}

// -- parameter profiles ---------------------------------------------------------------------------

// Stretches of a drive in one region: [first, last] poses with the region's colour.
function stretchesOf(profile) {
  const stretches = [];
  profile.regions.forEach((region, n) => {
    const shade = D.profiles.regions[region].color;
    const latest = stretches[stretches.length - 1];
    if (latest && latest.color === shade) latest.last = n;
    else stretches.push({first: Math.max(n - 1, 0), last: n, color: shade});
  });
  return stretches;
}

function showProfiles() {
  const {drawn, parameters, regions, outline} = D.profiles;
  for (const {world} of drawn) unpack(world.drives[0], world.period);
  let profile = drawn[0];

  const select = make("select", {"aria-label": "Method and world of the profile"});
  drawn.forEach(({method, world}, n) =>
    select.append(make("option", {value: n}, `${method} in ${world.name}`)),
  );
  const clock = new Clock(1, [1, 2, 4, 10]);
  const figure = make("figure");
  const room = make("p", {class: "note"});
  const parameterBox = make("div", {class: "small"});
  const unchanged = make("p", {class: "note"});
  const entries = regions.map(({words, color: name}) => ({
    swatch: "line",
    color: `var(--${name})`,
    words,
  }));
  entries.push({dash: [3, 3], color: "var(--soft)", words: "default of the parameter"});
  document
    .getElementById("profiles")
    .append(
      make("h2", {}, "Parameters along a drive"),
      make("div", {class: "controls"}, select),
      figure,
      legend(entries),
      clock.controls,
      room,
      parameterBox,
      unchanged,
      make(
        "p",
        {class: "note"},
        "Coloured: the room around the robot. This is the paper's figure of parameter profiles.",
      ),
    );
  const view = new TopView(
    figure,
    viewOf(profile.world),
    paintProfile,
    "Map with the driven path, coloured by the room around the robot",
    () => 360,
  );
  let charts = [];

  function paintProfile() {
    const {world} = profile;
    const drive = world.drives[0];
    paintWorld(view, world, clock.time);
    for (const {first, last, color: name} of stretchesOf(profile)) {
      const points = drive.poses.slice(first, last + 1).map(pose => [pose[0], pose[1]]);
      view.line(points, color(name), 4);
    }
    view.robot(outline, poseAt(drive, clock.time), color("brand"), color("paper"));
    paintCourse(view, world);
  }

  function showProfile() {
    const drive = profile.world.drives[0];
    const bands = stretchesOf(profile).map(({first, last, color: name}) => [
      drive.times[first],
      drive.times[last],
      `var(--${name})`,
    ]);
    view.show(viewOf(profile.world));
    const options = {
      x: [0, drive.end],
      bands,
      onpick: time => {
        clock.pause();
        clock.set(time);
      },
    };
    const line = {color: "var(--ink)"};
    charts = parameterCharts(parameterBox, unchanged, parameters, [drive], [line], options, true);
    clock.restart(drive.end);
  }

  select.onchange = () => {
    profile = drawn[select.value];
    showProfile();
  };
  clock.listeners.push(time => {
    view.draw();
    const pose = indexAt(profile.world.drives[0].times, time);
    room.textContent = `Room around the robot: ${regions[profile.regions[pose]].words}.`;
    for (const {chart, words} of charts) chart.cursor(time, words(time));
  });
  showProfile();
}

if (D.profiles.drawn) showProfiles();
