// The report's figure: mean times against world index, as in the paper. D is what report.py packs.
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

function showGroup(group) {
  const series = methods.map(method => ({
    color: methodColor(D.methods[method]),
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
      .map(one => ({color: one.color, dash: "5 4", points: fitOf(one.points)})),
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
  const entries = methods.map(method => ({color: methodColor(D.methods[method]), words: method}));
  host.append(make("h2", {}, "Time against world"), legend(entries));
  D.groups.forEach(showGroup);
  host.append(
    make(
      "p",
      {class: "note"},
      "Dashed: linear fits. This is the paper's figure of its environments.",
    ),
  );
}
