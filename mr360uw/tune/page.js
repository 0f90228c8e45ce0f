// Keys of the whole page; the server is told their names by the event "tune".
document.addEventListener("keydown", (event) => {
  const typing = event.target.matches?.("input[type=text], input[type=search], textarea");
  const free = event.target === document.body || event.target.matches?.(".page-keys");
  const control = event.ctrlKey || event.metaKey;
  const key = event.key.toLowerCase();
  let name = null;
  if (control && key === "s") name = "save";
  else if (control && !typing && key === "z") name = event.shiftKey ? "redo" : "undo";
  else if (control && !typing && key === "y") name = "redo";
  else if (free && !control && !event.altKey)
    name = { " ": "play", arrowleft: "back", arrowright: "forward", home: "start", end: "end",
      ",": "darker", ".": "brighter" }[key];
  if (!name) return;
  event.preventDefault();
  document.activeElement?.matches("input[type=number]") && document.activeElement.blur(); // its change counts first
  emitEvent("tune", name);
});
