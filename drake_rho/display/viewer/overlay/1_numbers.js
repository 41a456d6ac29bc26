// Overlay of names, numbers and controls over Drake's Meshcat.
//
// The scene and its recording are Meshcat's, in the global `viewer`. This module holds the current
// time, seeks the recording to it, and shows the numbers of the block of data, which Python computed.
// All names are inserted as text, never as markup. Films and tests use `window.drakeRho`.
"use strict";

const data = JSON.parse(document.getElementById("drake-rho").textContent);
const THREE = MeshCat.THREE;
const VIEWS = { free: data.view, top: [-90, 89.9], side: [-90, 0] }; // azimuth, elevation [deg]
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8];
const FOLDED = 8; // rows of a folded table
const LOW = 480; // height of a window in which the scene is beside the headline [px]
const SMALLEST = 0.6; // least scale of the numbers in a film, at which they can still be read
const SCALES = {
  // from low to high, evenly spaced: viridis, and red (no clearance) to yellow to blue
  speed: ["#440154", "#414487", "#2a788e", "#22a884", "#7ad151", "#fde725"],
  clearance: ["#c4161c", "#f4803c", "#fbd14b", "#8fc9b5", "#3f8fc4", "#2c5aa0"],
};
const state = {
  time: 0, playing: true, speed: 1, loop: true, view: "free", follow: null, colour: "vehicle",
  sort: "order", descending: false, unfolded: data.vehicles.length <= FOLDED + 4, tween: null, film: false, most: FOLDED,
};
if (data.lights.length) state.colour = "lights";
if (!state.unfolded) state.sort = "clearance"; // the least clearances of a fleet first
let order = data.vehicles.map((_, index) => index); // vehicles of the rows, from the top
let ordered = 0; // time at which the rows were last sorted [ms]

// ---------------------------------------------------------------- numbers

/** Return the frame at or before a time, and the fraction of the interval to the next frame. */
function frameAt(time, times = data.times) {
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

/** Return all numbers at the current time. */
function readings() {
  const at = frameAt(state.time);
  return {
    time: data.start + state.time,
    speeds: data.speeds.map((values) => between(values, at)),
    clearances: data.clearances.map((values) => between(values, at)),
    nearest: data.nearest.map((values) => values[at[0] + Math.round(at[1])] ?? values.at(-1)),
    left: data.requirements.map(({ left }) => between(left, at)),
    curves: data.curves.map((curve) => between(curve.values, frameAt(state.time, curve.times))),
  };
}

function inDigits(value, unit = "") {
  if (value === null) return "–";
  const size = Math.abs(value);
  const decimals = size >= 100 || size === 0 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : 3;
  const text = value.toFixed(decimals).replace(/^-(?=[0.]*$)/, "").replace("-", "−");
  return unit ? `${text}\u00a0${unit}` : text;
}

/** Return the name of the nearest obstacle or vehicle. */
function nearestName(number) {
  const bodies = data.obstacles.length;
  return number < bodies ? data.obstacles[number].name : data.vehicles[number - bodies].name;
}

// ---------------------------------------------------------------- elements

function element(parent, tag, className = "", text = "") {
  const made = document.createElement(tag);
  if (className) made.className = className;
  if (text) made.textContent = text;
  parent.append(made);
  return made;
}

/** Return a card, a landmark with a name. */
function card(tag, name, title) {
  const made = element(overlay, tag, `card ${name}`);
  made.setAttribute("aria-label", title);
  return made;
}

function drawing(parent, tag, attributes = {}) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  parent.append(made);
  return made;
}

/** Give a control its title, which is also its name where it has no words of its own. */
function called(made, title) {
  made.title = title;
  if (!/[a-z]/i.test(made.textContent) || made.tagName === "SELECT") made.setAttribute("aria-label", title);
  return made;
}

function button(parent, text, title, action) {
  const made = called(element(parent, "button", "", text), title);
  made.addEventListener("click", action);
  return made;
}

function choice(parent, title, options, action) {
  const made = called(element(parent, "select"), title);
  for (const [value, text] of options) element(made, "option", "", text).value = value;
  made.addEventListener("change", () => action(made.value));
  return made;
}

/** Show a button as on or off. */
function press(made, on) {
  made.setAttribute("aria-pressed", on);
}

document.title = `${data.name} – drake_rho`;
document.documentElement.lang = "en";
const overlay = element(document.body, "div");
overlay.id = "overlay";
const labels = element(overlay, "div", "labels");
labels.setAttribute("aria-hidden", true); // the table has all names of vehicles
viewer.dom_element.setAttribute("role", "main");
viewer.dom_element.setAttribute("aria-label", "scene");
