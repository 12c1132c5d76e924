// The page works without this script: it shows the first image, and the map without a time.
"use strict";
const drive = JSON.parse(document.getElementById("drive").textContent);
const map = document.getElementById("map");
const slider = document.getElementById("time");
const SVG = "http://www.w3.org/2000/svg";

// Texts and boxes of the map keep their size on the screen.
function fit() {
  const scale = map.getScreenCTM();
  if (scale) map.style.setProperty("--px", 1 / scale.a);
}

function add(parent, kind, attributes, text) {
  const made = document.createElementNS(SVG, kind);
  for (const name in attributes) made.setAttribute(name, attributes[name]);
  if (text !== undefined) made.textContent = text;
  parent.append(made);
  return made;
}

function box([x, y, angle], [length, width]) {
  const cos = Math.cos(angle), sin = Math.sin(angle);
  const corner = (u, v) => `${x + u * cos - v * sin},${y + u * sin + v * cos}`;
  const front = corner(length / 2, 0), side = length / 4;
  return [corner(side, -width / 2), corner(-length / 2, -width / 2), corner(-length / 2, width / 2),
    corner(side, width / 2), front].join(" ");
}

function showTime(k) {
  slider.value = k;
  document.getElementById("now").textContent = `${drive.times[k].toFixed(1)} s`;
  const now = document.getElementById("objects");
  now.replaceChildren();
  for (const track of drive.tracks) {
    const place = track.places[k - track.first];
    if (!place) continue;
    add(now, "polygon", { points: box(place, track.size), fill: track.color });
    add(now, "text", { x: place[0], y: place[1], dy: "-.7em" }, track.id);
  }
  add(now, "polygon", { points: box(drive.path[k], drive.ego), class: "ego" });
}

let playing;
function stop() {
  clearInterval(playing);
  playing = undefined;
  document.getElementById("play").textContent = "play";
}
document.getElementById("play").onclick = () => {
  if (playing) return stop();
  document.getElementById("play").textContent = "stop";
  const pause = (1000 * (drive.times.at(-1) - drive.times[0])) / Math.max(drive.times.length - 1, 1);
  playing = setInterval(() => showTime((+slider.value + 1) % drive.times.length),
    Math.min(Math.max(pause, 50), 1000));
};
slider.oninput = () => { stop(); showTime(+slider.value); };

function nearest(seconds) {
  let best = 0;
  drive.times.forEach((time, k) => {
    if (Math.abs(time - seconds) < Math.abs(drive.times[best] - seconds)) best = k;
  });
  return best;
}

for (const book of document.querySelectorAll(".flip")) {
  book.addEventListener("flip", (event) => { stop(); showTime(nearest(event.detail)); });
  slider.value = nearest(+book.dataset.seconds);
}

addEventListener("resize", fit);
fit();
showTime(+slider.value);
