// Keys of the whole page; the server is told their names by the event "tune".
document.addEventListener("keydown", (event) => {
  const typing = event.target.matches?.("input[type=text], input[type=search], textarea");
  const field = event.target.closest?.("input, select, textarea");
  const free = !field && !event.target.closest?.("button, summary, a, [tabindex='0'], .controls-list"); // with keys of their own
  const control = event.ctrlKey || event.metaKey;
  const key = event.key.toLowerCase();
  let name = null;
  if (control && key === "s") name = "save";
  else if (control && !typing && key === "z") name = event.shiftKey ? "redo" : "undo";
  else if (control && !typing && key === "y") name = "redo";
  else if (key === "escape" && !event.defaultPrevented && !event.target.closest(".controls") && !document.querySelector(".q-dialog, .q-menu")) name = "close";
  else if (!field && !control && !event.altKey) {
    name = { ",": "darker", ".": "brighter", h: "marks" }[key];
    if (free) name ??= { " ": "play", arrowleft: "back", arrowright: "forward", home: "start", end: "end" }[key];
  }
  if (!name) return;
  event.preventDefault();
  document.activeElement?.matches("input[type=number]") && document.activeElement.blur(); // its change counts first
  emitEvent("tune", name);
});
