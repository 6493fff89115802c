// Marks on a map, such as the numbers of events, which stand beside their places.
const MARK_PX = 26; // distance of two marks on the map, at least

// Push places [[x, y], ...] on a canvas apart from each other, but not out of it.
function spread(at, width, tall) {
  for (let round = 0; round < 50; round++) {
    for (const a of at) {
      for (const b of at) {
        const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
        const distance = Math.hypot(dx, dy);
        if (a === b || distance >= MARK_PX) continue;
        const push = (MARK_PX - distance) / 2 + 0.5;
        const [ux, uy] = distance ? [dx / distance, dy / distance] : [1, 0];
        b[0] += ux * push;
        b[1] += uy * push;
        a[0] -= ux * push;
        a[1] -= uy * push;
      }
    }
    for (const place of at) {
      place[0] = Math.min(Math.max(place[0], 14), width - 14);
      place[1] = Math.min(Math.max(place[1], 14), tall - 14);
    }
  }
}

// Put marks, which are elements of a view, beside their places [[x, y], ...], with a line to each.
function placeMarksBeside(view, positions, marks) {
  const places = positions.map(place => view.at(...place));
  const at = places.map(([x, y]) => [x + 20, y - 20]);
  spread(at, view.width, view.tall);
  view.pixels();
  view.c.strokeStyle = color("ink");
  view.c.lineWidth = 1.5;
  const offset = view.canvas.offsetLeft;
  marks.forEach((mark, n) => {
    view.c.beginPath();
    view.c.moveTo(...places[n]);
    view.c.lineTo(...at[n]);
    view.c.stroke();
    mark.style.left = `${at[n][0] + offset}px`;
    mark.style.top = `${at[n][1]}px`;
  });
  view.metres();
}
