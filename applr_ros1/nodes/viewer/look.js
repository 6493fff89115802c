// Runs in viser's page before viser: the scheme of the page, and names for readers of the screen.
"use strict";
const dark = matchMedia("(prefers-color-scheme: dark)");
// viser reads this variable once.
window.__VISER_EMBED_CONFIG__ = {darkMode: dark.matches};
dark.addEventListener("change", () => location.reload());
document.documentElement.id = "page";

// viser names neither its sliders, nor the numbers beside them, nor the buttons without words.
const BUTTONS = {
  "list-search": "Commands",
  adjustments: "Settings of the view",
};

function nameControls() {
  document.getElementById("root").setAttribute("role", "main");
  for (const label of document.querySelectorAll("label[for]")) {
    // The label is in a paragraph in a box in the row.
    const row = label.parentElement.parentElement.parentElement;
    for (const control of row.querySelectorAll("[role=slider], input:not([type=checkbox])"))
      control.setAttribute("aria-label", label.textContent);
  }
  for (const button of document.querySelectorAll("button:not([aria-label])")) {
    const icon = Object.keys(BUTTONS).find(name => button.querySelector(`.tabler-icon-${name}`));
    if (icon) button.setAttribute("aria-label", BUTTONS[icon]);
    else if (!button.textContent) button.setAttribute("aria-label", "Close");
  }
}

// viser makes its controls when they arrive.
let isAwaited = false;
new MutationObserver(() => {
  if (isAwaited) return;
  isAwaited = true;
  setTimeout(() => {
    isAwaited = false;
    nameControls();
  }, 200);
}).observe(document, {childList: true, subtree: true});
