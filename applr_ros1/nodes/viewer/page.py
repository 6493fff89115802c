"""What viser has no element for: a bar that always stays, a notice over the scene, and HTML to press on.

Python makes the HTML. A small script puts it in its place and sends what a pressed element's data-send says, which is
what viser's own elements send.
"""

from __future__ import annotations

import html
import json
from typing import Any, Dict

ACCENT = (28, 126, 214)  # of what to press next
STYLE = """
:root { --bar: 52px; --sheet: 0px; --accent: rgb(28, 126, 214) }
#root { height: calc(100% - var(--bar) - var(--sheet)) }
#bar { position: fixed; inset: auto 0 0 0; height: var(--bar); box-sizing: border-box; padding: 0 12px; z-index: 50;
  display: flex; align-items: center; gap: 4px 14px; background: #fff; border-top: 1px solid #dee2e6; color: #343a40;
  font-size: 14px }
#state { flex: 1; display: flex; flex-wrap: wrap; gap: 2px 16px; align-items: baseline; overflow: hidden;
  max-height: 100% } #state span:empty { display: none }
#state .speed { min-width: 4.5em; font-variant-numeric: tabular-nums } #state .trouble { color: #c92a2a }
#buttons { display: flex; gap: 8px }
#buttons button, .mantine-Button-root:not([style*="--button-bg"]) { background: #f1f3f5; color: #343a40;
  border: 1px solid #dee2e6; border-radius: 4px; font: inherit; cursor: pointer }
#buttons button { padding: 6px 14px; min-height: 34px; white-space: nowrap }
#buttons .next { background: var(--accent); border-color: var(--accent); color: #fff }
#buttons button[data-key]::after { content: " " attr(data-key); opacity: .55; font-size: 11px }
#notice { position: fixed; bottom: calc(var(--bar) + var(--sheet) + 12px); left: 12px;
  max-width: min(30em, calc(100% - 24px)); box-sizing: border-box;
  padding: 10px 14px; z-index: 40; background: #fffffff0; border-left: 4px solid var(--accent); color: #343a40;
  font-size: 14px; box-shadow: 0 1px 6px #0003; pointer-events: none } #notice:empty { display: none }
#legend { position: fixed; top: 10px; left: 12px; padding: 6px 10px; z-index: 30; background: #ffffffd0; color: #343a40;
  font-size: 14px; border-radius: 4px; pointer-events: none } #legend:empty { display: none }
.tiles { display: grid; grid-template-columns: repeat(3, 1fr); gap: 6px; padding: 0 10px 8px; font-size: 12px }
.tiles div { cursor: pointer; text-align: center; border: 1px solid #dee2e6; border-radius: 4px; padding: 4px 2px }
.tiles div:hover, .tiles .now { border-color: var(--accent) } .tiles img { width: 100%; display: block }
@media (max-width: 36em) {
  :root { --bar: 92px } #bar { flex-direction: column; align-items: stretch; padding: 6px 10px; gap: 4px }
  #buttons button { flex: 1; padding: 4px } #buttons button[data-key]::after { content: none }
  .mantine-Paper-root[style*="fixed"] { bottom: var(--bar) !important; max-height: 40% !important }
  .mantine-Paper-root[style*="fixed"], .mantine-Paper-root[style*="fixed"] div[style*="20em"] { width: 100% !important }
}
"""
SCRIPT = """
(() => {
  const at = name => document.getElementById(name);
  if (!at("bar")) {
    document.body.insertAdjacentHTML("beforeend",
      "<div id=bar><div id=state></div><div id=buttons></div></div><div id=notice></div><div id=legend></div>");
    document.head.append(Object.assign(document.createElement("style"), {textContent: STYLE}));
    document.addEventListener("click", event => {
      const pressed = event.target.closest("[data-send]");
      if (pressed) window.__viserMutable.sendMessage(JSON.parse(pressed.dataset.send));
      if (event.target.closest("canvas, #buttons")) localStorage.setItem("applr", "used");
    });
    document.addEventListener("pointerdown", event => {  // viser passes over what is captured, as every touch is
      const {target, pointerId} = event;
      if (target.dataset.engine && target.hasPointerCapture(pointerId)) target.releasePointerCapture(pointerId);
    }, true);
    setInterval(() => {
      const sheet = document.querySelector('.mantine-Paper-root[style*="fixed"]');
      document.documentElement.style.setProperty("--sheet", (sheet ? sheet.offsetHeight : 0) + "px");
      const now = window.applr.now;  // a slow page hears only when it draws
      const silent = Date.now() - window.applr.heard > 4000 && window.applr.drawn > 8;
      const lost = silent && !now.notice ? "No connection to the viewer: waiting for it." : now.notice || "";
      const text = lost ? lost.replace("SECONDS", Math.round((Date.now() - window.applr.since) / 1000))
        : localStorage.getItem("applr") ? "" : now.hint || "";
      if (at("notice").innerHTML !== text) at("notice").innerHTML = text;
    }, 250);
    window.applr = parts => {
      const applr = window.applr;
      applr.heard = Date.now();
      applr.drawn = 0;
      if ((parts.notice || "") !== (applr.now.notice || "") && "notice" in parts) applr.since = Date.now();
      for (const name of ["state", "buttons", "legend"]) if (name in parts) at(name).innerHTML = parts[name];
      if (parts.title) document.title = parts.title;
      Object.assign(applr.now, parts);
    };
    Object.assign(window.applr, {now: {}, heard: Date.now(), since: Date.now(), drawn: 0});
    const draw = () => { window.applr.drawn++; requestAnimationFrame(draw); };
    draw();
  }
})();
""".replace("STYLE", json.dumps(STYLE))


def sends(element: Any, value: Any = None) -> str:
    """The HTML attribute that makes an element of a page run a command of viser's, or give an input a value."""
    message = {"type": "GuiUpdateMessage", "uuid": element._impl.uuid, "updates": {"value": value}}
    if value is None:
        message = {"type": "CommandTriggerMessage", "uuid": element._impl.uuid}
    return f'data-send="{html.escape(json.dumps(message))}"'


class Page:
    """One open page. client: viser's; view: of its camera, one of scene.VIEWS."""

    def __init__(self, client: Any):
        self.client, self.view = client, "behind"
        self._shown: Dict[str, str] = {}
        self._run(SCRIPT)

    def show(self, **parts: str) -> None:
        """Bring parts of the page up to date: title, and HTML: state and buttons of the bar, notice, hint, legend."""
        news = {name: part for name, part in parts.items() if self._shown.get(name) != part}
        self._shown.update(news)
        self._run(f"applr({json.dumps(news)})")

    def _run(self, script: str) -> None:
        from viser._messages import RunJavascriptMessage

        self.client.gui._websock_interface.queue_message(RunJavascriptMessage(script))
