// Hides the last verdict when the server falls silent: the page must never keep an old OK.
let beat = "", beatAt = 0;
function checkBeat() {
  const text = document.getElementById("beat")?.textContent ?? "";
  if (text !== beat) [beat, beatAt] = [text, Date.now()];
  document.body.classList.toggle("lost", !beat || Math.abs(Date.now() - beatAt) > 1500);
}
setInterval(checkBeat, 200);
for (const event of ["visibilitychange", "pageshow", "focus"]) addEventListener(event, checkBeat);
