// Page of the logbook of ./applr why: the change that helps most, the places, reasons, parameters
// and days of lost time, and all stops. D is what logbook_page.py packs.
const SHOWN_PLACES = 12; // number of places with a number on the map
const LARGEST_PX = 24; // radius of the disc at the place that cost most time
const SMALLEST_PX = 5;
const ROOM_M = 2; // room around the drives on the map

// Words of the command with the arrows of the page.
function readable(words) {
  return words.replaceAll(" -> ", " → ");
}

function secondsOf(value) {
  return `${fixed(value, value < 10 ? 1 : 0)} s`;
}

function counted(count, noun) {
  return count === 1 ? `1 ${noun}` : `${count} ${noun}s`;
}

content.append(...D.advice.map(line => make("p", {class: "advice"}, readable(line))));

// -- where ----------------------------------------------------------------------------------------

const lostOnFloor = D.floors.map((_, n) =>
  D.places.filter(place => place.floor === n).reduce((sum, place) => sum + place.lost, 0),
);
let floor = lostOnFloor.indexOf(Math.max(...lostOnFloor));
const figure = make("figure");
const floorChoice = make("select", {
  "aria-label": "Frame of the map",
  onchange: () => showFloor(Number(floorChoice.value)),
});
D.floors.forEach((one, n) => {
  const words = `${one.frame} ${n + 1}: ${counted(one.tracks.length, "drive")}, ${secondsOf(lostOnFloor[n])} lost`;
  floorChoice.append(make("option", {value: n}, words));
});

function placesHere() {
  return D.places.filter(place => place.floor === floor);
}

function boxOf(one) {
  const points = [...one.tracks.flat(), ...placesHere().map(place => place.place)];
  const [left, right] = rangeOf(points.map(point => point[0]));
  const [low, high] = rangeOf(points.map(point => point[1]));
  const room = [left - ROOM_M, low - ROOM_M, right + ROOM_M, high + ROOM_M];
  return room.every(Number.isFinite) ? room : [-1, -1, 1, 1];
}

function paintFloor(view) {
  const one = D.floors[floor];
  const size = Math.max(one.cell, 2 / view.scale);
  view.c.fillStyle = color("obstacle");
  for (const [x, y] of one.points) view.c.fillRect(x - size / 2, y - size / 2, size, size);
  for (const track of one.tracks) view.line(track, color("soft"), 1);
  const here = placesHere();
  const most = Math.max(...D.places.map(place => place.lost), 1e-9);
  view.c.globalAlpha = 0.55;
  for (const place of here) {
    const radius = SMALLEST_PX + (LARGEST_PX - SMALLEST_PX) * Math.sqrt(place.lost / most);
    view.disc(...place.place, radius / view.scale, color("slow"));
  }
  view.c.globalAlpha = 1;
  const numbered = here.slice(0, SHOWN_PLACES);
  placeMarksBeside(
    view,
    numbered.map(place => place.place),
    marks,
  );
}

let marks = [];
content.append(make("h2", {}, "Where time is lost"));
if (D.floors.length > 1) content.append(make("div", {class: "controls"}, floorChoice));
content.append(figure);
const view = new TopView(
  figure,
  boxOf(D.floors[floor]),
  paintFloor,
  "Map of all drives with the places where time is lost",
);
figure.append(
  legend([
    {color: "var(--slow)", words: "place where time is lost, larger for more time"},
    {swatch: "line", color: "var(--soft)", words: "driven paths"},
    {
      swatch: "square",
      color: "var(--obstacle)",
      words: D.floors.some(one => one.has_map) ? "map, or seen by the laser" : "seen by the laser",
    },
  ]),
  make("p", {class: "note"}, "A click on a number shows the stops there."),
);

function showFloor(n) {
  floor = n;
  floorChoice.value = n;
  marks.forEach(mark => mark.remove());
  marks = placesHere()
    .slice(0, SHOWN_PLACES)
    .map((place, number) => {
      const words = `${secondsOf(place.lost)} in ${counted(place.stops.length, "stop")} at ${place.words}`;
      return make(
        "button",
        {
          type: "button",
          class: "mark",
          title: words,
          "aria-label": `Place ${number + 1}: ${words}`,
          onclick: () => select(place, marks[number]),
        },
        String(number + 1),
      );
    });
  view.element.append(...marks);
  view.show(boxOf(D.floors[n]));
}

// -- why and when ---------------------------------------------------------------------------------

const rowButtons = [];

function barsOf(groups) {
  const most = Math.max(...groups.map(group => group.lost), 1e-9);
  const grid = make("div", {
    class: "rows",
    style: "grid-template-columns: minmax(0, 2fr) minmax(3rem, 1fr) max-content",
  });
  for (const group of groups) {
    const words = readable(group.words);
    const button = make("button", {type: "button", onclick: () => select(group, button)}, words);
    rowButtons.push(button);
    const svg = make(
      "svg",
      {"aria-hidden": "true"},
      make("rect", {
        width: `${(100 * group.lost) / most}%`,
        y: 4,
        height: 18,
        fill: "var(--slow)",
      }),
    );
    const result = `${secondsOf(group.lost)}, ${counted(group.stops.length, "stop")}`;
    grid.append(make("div", {}, button, svg, make("span", {class: "right"}, result)));
  }
  return grid;
}

for (const [title, groups] of [
  ["Why: the reason", D.reasons],
  ["What the replay would change first", D.parameters],
  ["When", D.days],
]) {
  if (groups.length) content.append(make("h2", {}, title), barsOf(groups));
}

// -- the stops ------------------------------------------------------------------------------------

const stopsTitle = make("h2", {tabindex: -1}, "All stops");
const stopRows = make("tbody");
const allButton = make(
  "button",
  {type: "button", hidden: true, onclick: () => select(null, null)},
  "Show all stops",
);

function stopRow(n) {
  const stop = D.events[n];
  const link = D.links[n];
  const when = `${stop.bag}, ${fixed(stop.begin, 1)} s`;
  const because = stop.is_guessed ? "perhaps because" : "because";
  const reason = stop.reason ? `${stop.kind}, ${because} ${stop.reason}` : stop.kind;
  return make(
    "tr",
    {},
    make("td", {class: "number"}, secondsOf(stop.lost)),
    make("td", {}, link ? make("a", {href: link}, when) : when),
    make("td", {}, readable(reason)),
    make("td", {}, readable(stop.guess)),
  );
}

function showStops(title, numbers) {
  stopsTitle.textContent = title;
  stopRows.replaceChildren(...numbers.map(stopRow));
  allButton.hidden = numbers.length === D.events.length;
}

// Show the stops of a group, or all of them.
function select(group, button) {
  for (const one of [...marks, ...rowButtons]) one.setAttribute("aria-pressed", one === button);
  if (group === null) {
    showStops("All stops", [...D.events.keys()]);
    return;
  }
  showStops(
    `${counted(group.stops.length, "stop")}, ${secondsOf(group.lost)}: ${readable(group.words)}`,
    group.stops,
  );
  stopsTitle.focus();
}

const heads = ["lost", "stop", "what and why", "the replay's guess"];
content.append(
  stopsTitle,
  allButton,
  wideTable(heads, stopRows, {class: "words"}, ["lost"]),
  make("p", {class: "note"}, "A link opens the page of the drive, at this stop."),
);

// -- what was tried -------------------------------------------------------------------------------

if (D.driven) {
  const rows = [D.driven.recorded, ...D.driven.tried].map(one =>
    make("tr", {}, make("td", {}, readable(one.words)), make("td", {}, one.result)),
  );
  const count = D.driven.bags.length;
  const worlds = count === 1 ? "world" : "worlds";
  const driven = ["values", `driven in the ${worlds} of ${counted(count, "stop")}`];
  content.append(
    make("h2", {}, "What was tried"),
    wideTable(driven, make("tbody", {}, ...rows), {class: "words"}),
  );
}
if (D.notes.length)
  content.append(
    make(
      "details",
      {open: true},
      make("summary", {}, "Left out"),
      make("ul", {}, ...D.notes.map(note => make("li", {}, note))),
    ),
  );
content.append(
  make(
    "details",
    {},
    make("summary", {}, "The answer in text"),
    make("pre", {tabindex: 0}, D.lines.join("\n")),
  ),
);
showFloor(floor);
select(null, null);
