// What is laid over Drake's Meshcat: names, numbers and controls.
//
// The scene and its recording are Meshcat's, in the global `viewer`. This module owns the time: it
// moves the recording to it, and says what the block of data, computed in Python, holds for it. All
// names are set as text, never as markup. `window.drakeRho` is what films and tests hold on to.
"use strict";

const told = JSON.parse(document.getElementById("drake-rho").textContent);
const THREE = MeshCat.THREE;
const VIEWS = { free: told.view, top: [-90, 89.9], side: [-90, 0] }; // azimuth, elevation [deg]
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8];
const FOLDED = 8; // rows of a fleet that is folded
const SCALES = {
  // from low to high, evenly spaced: viridis, and from red (nothing left) over yellow to blue
  speed: ["#440154", "#414487", "#2a788e", "#22a884", "#7ad151", "#fde725"],
  clearance: ["#c4161c", "#f4803c", "#fbd14b", "#8fc9b5", "#3f8fc4", "#2c5aa0"],
};
const state = {
  time: 0, playing: true, speed: 1, loop: true, view: "free", follow: null, colour: "vehicle",
  sort: "order", descending: false, unfolded: told.vehicles.length <= FOLDED + 4, tween: null, film: false,
};
if (!state.unfolded) state.sort = "clearance"; // of a fleet those that have least room
let order = told.vehicles.map((_, index) => index); // of the rows, from the top
let ordered = 0; // when they were last sorted [ms]

// ---------------------------------------------------------------- numbers

/** Frame at or before a time, and how far the time is on the way to the next one. */
function frameAt(time, times = told.times) {
  let low = 0;
  let high = times.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time) low = middle;
    else high = middle;
  }
  return [low, Math.min(1, Math.max(0, (time - times[low]) / (times[high] - times[low])))];
}

function between(values, [frame, part]) {
  const one = values[frame];
  const next = values[Math.min(frame + 1, values.length - 1)];
  return one === null || next === null ? null : one + part * (next - one);
}

/** What is read off at the present time. */
function readings() {
  const at = frameAt(state.time);
  return {
    time: told.start + state.time,
    speeds: told.speeds.map((values) => between(values, at)),
    clearances: told.clearances.map((values) => between(values, at)),
    nearest: told.nearest.map((values) => values[at[0] + Math.round(at[1])] ?? values.at(-1)),
    curves: told.curves.map((curve) => between(curve.values, frameAt(state.time, curve.times))),
  };
}

function inDigits(value, unit = "") {
  if (value === null) return "–";
  const size = Math.abs(value);
  const decimals = size >= 100 || size === 0 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : 3;
  const text = value.toFixed(decimals).replace(/^-(?=[0.]*$)/, "").replace("-", "−");
  return unit ? `${text} ${unit}` : text;
}

/** What is nearest to a vehicle: an obstacle's name or a vehicle's. */
function nearestName(number) {
  const bodies = told.obstacles.length;
  return number < bodies ? told.obstacles[number].name : told.vehicles[number - bodies].name;
}

// ---------------------------------------------------------------- elements

function element(parent, tag, className = "", text = "") {
  const made = document.createElement(tag);
  if (className) made.className = className;
  if (text) made.textContent = text;
  parent.append(made);
  return made;
}

function drawing(parent, tag, attributes = {}) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  parent.append(made);
  return made;
}

function button(parent, text, title, action) {
  const made = element(parent, "button", "", text);
  made.title = title;
  made.addEventListener("click", action);
  return made;
}

function choice(parent, title, options, action) {
  const made = element(parent, "select");
  made.title = title;
  for (const [value, text] of options) element(made, "option", "", text).value = value;
  made.addEventListener("change", () => action(made.value));
  return made;
}

document.title = `${told.name} – drake_rho`;
const overlay = element(document.body, "div");
overlay.id = "overlay";
const labels = element(overlay, "div", "labels");
