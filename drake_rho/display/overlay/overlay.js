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

const overlay = element(document.body, "div");
overlay.id = "overlay";
const labels = element(overlay, "div", "labels");

// ---------------------------------------------------------------- title, tools, transport

const title = element(overlay, "section", "card headline");
element(title, "h1", "", told.name).title = told.name;
const clock = element(title, "div", "clock num");
const clockValue = element(clock, "span");
element(clock, "small", "", "s");
const moment = element(title, "div", "soft num");

const tools = element(overlay, "nav", "card tools");
const views = Object.fromEntries(
  Object.keys(VIEWS).map((name, index) => [
    name,
    button(tools, name[0].toUpperCase() + name.slice(1), `camera: ${name} (${index + 1})`, () => look(name)),
  ]),
);
const followed = choice(
  tools, "follow a vehicle", [["", "Follow…"], ...told.vehicles.map(({ label }, index) => [index, label])],
  (value) => follow(value === "" ? null : Number(value)),
);
const coloured = choice(
  tools, "colour by", [["vehicle", "Colour: vehicle"], ...Object.keys(told.ranges).map((by) => [by, `Colour: ${by}`])],
  colourBy,
);
const menu = element(tools, "div", "menu");
button(menu, "Show ▾", "what is shown", () => menu.classList.toggle("open"));
const layers = element(menu, "div", "card");
button(tools, "◐", "light or dark (d)", () => theme(!dark()));
button(tools, "▤", "numbers (n)", () => fold(!document.body.classList.contains("folded")));

const transport = element(overlay, "nav", "card transport");
const playButton = button(transport, "", "play or pause (space)", () => play(!state.playing));
playButton.className = "play";
const slider = element(transport, "input");
Object.assign(slider, { type: "range", min: 0, max: told.duration, step: "any", title: "time" });
slider.addEventListener("input", () => seek(Number(slider.value)));
const end = element(transport, "span", "soft num");
choice(transport, "speed", SPEEDS.map((speed) => [speed, `${speed} ×`]), (value) => (state.speed = Number(value))).value = 1;
const loopButton = button(transport, "↻", "again from the start (l)", () => loop(!state.loop));

// ---------------------------------------------------------------- vehicles

const panel = element(overlay, "aside", "card panel");
const scroller = element(panel, "div", "rows");
const table = element(scroller, "table");
const heads = element(element(table, "thead"), "tr");
const COLUMNS = { order: "vehicle", speed: "[m/s]", clearance: "clearance [m]" };
for (const [key, text] of Object.entries(COLUMNS)) {
  const head = element(heads, "th", "", text);
  head.dataset.key = key;
  head.addEventListener("click", () => {
    state.descending = state.sort === key ? !state.descending : key === "speed";
    state.sort = key;
    update(true);
  });
}
const body = element(table, "tbody");
const more = button(panel, "", "all vehicles", () => {
  state.unfolded = !state.unfolded;
  update(true);
});
more.className = "more";
more.hidden = told.vehicles.length <= FOLDED + 4;

const rows = [];
function row(place) {
  if (rows[place]) return rows[place];
  const line = element(body, "tr");
  const name = element(line, "td");
  const made = {
    line, swatch: element(name, "i"), name: element(name, "span"),
    speed: element(line, "td", "num"), clearance: element(line, "td", "num"), vehicle: -1,
  };
  line.addEventListener("click", () => follow(state.follow === made.vehicle ? null : made.vehicle));
  return (rows[place] = made);
}

function sorted(now) {
  const order = told.vehicles.map((_, index) => index);
  const values = { speed: now.speeds, clearance: now.clearances }[state.sort];
  const key = values ? (index) => values[index] ?? Infinity : (index) => index;
  return order.sort((one, other) => (key(one) - key(other) || one - other) * (state.descending ? -1 : 1));
}

function updateTable(now, atOnce) {
  if (atOnce || performance.now() - ordered > 1000) {
    order = sorted(now); // once a second, to be read
    ordered = performance.now();
  }
  const shown = state.unfolded ? order.length : FOLDED;
  for (const head of heads.children) {
    const active = head.dataset.key === state.sort;
    head.className = active ? (state.descending ? "down" : "up") : "";
  }
  for (let place = 0; place < shown; place += 1) {
    const index = order[place];
    const each = row(place);
    if (each.vehicle !== index) {
      each.vehicle = index;
      each.name.textContent = told.vehicles[index].label;
    }
    const clear = now.clearances[index];
    each.swatch.style.background = colourOf(index, now);
    each.speed.textContent = inDigits(now.speeds[index]);
    each.clearance.textContent = inDigits(clear);
    each.clearance.classList.toggle("bad", clear !== null && clear < -told.tolerance);
    each.line.title = told.vehicles[index].name + (clear === null ? "" : ` – nearest: ${nearestName(now.nearest[index])}`);
    each.line.classList.toggle("followed", state.follow === index);
    each.line.hidden = false;
  }
  for (let place = shown; place < rows.length; place += 1) rows[place].line.hidden = true;
  more.textContent = state.unfolded ? "fold" : `all ${order.length} vehicles`;
}

// ---------------------------------------------------------------- plots

const WIDE = 264;
const HIGH = 74;
const plots = told.curves.map((curve) => {
  const box = element(panel, "section", "plot");
  const header = element(box, "header");
  element(header, "span", "", curve.title).title = curve.how;
  const value = element(header, "b", "num");
  const svg = drawing(box, "svg", { viewBox: `0 0 ${WIDE} ${HIGH}`, preserveAspectRatio: "none" });
  const [when, least] = curve.least;
  const highest = curve.values.reduce((most, value) => Math.max(most, value), curve.limit ?? 0);
  const bottom = Math.min(least, curve.limit ?? 0);
  const lowest = bottom - (curve.limit === null ? 0 : 0.12 * (highest - bottom));
  const x = (time) => (time / told.duration) * WIDE;
  const y = (height) => HIGH - 4 - ((height - lowest) / (highest - lowest || 1)) * (HIGH - 10);
  const points = thinned(curve).map((m) => `${x(curve.times[m]).toFixed(1)},${y(curve.values[m]).toFixed(2)}`);
  drawing(svg, "path", { class: "curve", d: `M${points.join("L")}` });
  if (curve.limit !== null) {
    drawing(svg, "rect", { class: "forbidden", x: 0, width: WIDE, y: y(curve.limit), height: HIGH - y(curve.limit) });
    drawing(svg, "line", { class: "limit", x1: 0, x2: WIDE, y1: y(curve.limit), y2: y(curve.limit) });
  }
  drawing(svg, "circle", { class: "lowest", cx: x(when), cy: y(least), r: 3.2 });
  const now = drawing(svg, "line", { class: "now", y1: 0, y2: HIGH });
  const drag = (event) => {
    if (event.buttons === 1) seek(((event.clientX - svg.getBoundingClientRect().left) / svg.clientWidth) * told.duration);
  };
  svg.addEventListener("pointerdown", drag);
  svg.addEventListener("pointermove", drag);
  const limit = curve.limit === null ? "no limit" : `limit ${curve.limit} m${told.knotsOnly ? " at the knots" : ""}`;
  const [who, whom] = curve.closest;
  element(box, "footer", "", `least ${inDigits(least, "m")} at ${inDigits(told.start + when, "s")}, ${who} – ${whom}; ${limit}`);
  if (curve.how) element(box, "footer", "", curve.how);
  return { curve, value, now, x };
});

/** Points of a curve that show in a plot: of those in one pixel the lowest and the highest. */
function thinned({ times, values }) {
  const bins = new Map();
  values.forEach((value, m) => {
    const bin = Math.floor((times[m] / told.duration) * WIDE * 2);
    const [low, high] = bins.get(bin) ?? [m, m];
    bins.set(bin, [value < values[low] ? m : low, value > values[high] ? m : high]);
  });
  return [...bins.values()].flatMap(([low, high]) => (low === high ? [low] : [low, high].sort((a, b) => a - b)));
}

function updatePlots(now) {
  plots.forEach(({ curve, value, now: line, x }, index) => {
    const present = now.curves[index];
    value.textContent = inDigits(present, "m");
    value.classList.toggle("bad", curve.limit !== null && present < curve.limit - told.tolerance);
    line.setAttribute("x1", x(state.time));
    line.setAttribute("x2", x(state.time));
  });
}

// ---------------------------------------------------------------- colours and themes

const dark = () => document.documentElement.classList.contains("dark");

/** A colour as it is seen on the present background: greys turned round, dark ones lifted. */
function seen(colour) {
  if (!dark()) return colour;
  const hsl = colour.getHSL({}, "srgb");
  if (hsl.s < 0.15) return colour.clone().setHSL(hsl.h, hsl.s, hsl.l > 0.7 ? 0.22 : hsl.l > 0.5 ? 0.45 : 0.85, "srgb");
  return colour.clone().setHSL(hsl.h, hsl.s, Math.max(hsl.l, 0.55), "srgb");
}

function onScale(by, value) {
  const [low, high] = told.ranges[by];
  const stops = SCALES[by];
  const place = Math.min(1, Math.max(0, ((value ?? high) - low) / (high - low || 1))) * (stops.length - 1);
  const first = Math.min(Math.floor(place), stops.length - 2);
  return new THREE.Color(stops[first]).lerp(new THREE.Color(stops[first + 1]), place - first);
}

const own = told.vehicles.map(({ colour }) => new THREE.Color(colour));
const inText = (colour) => `#${colour.getHexString()}`;

function vehicleColour(index, now) {
  if (state.colour === "vehicle") return seen(own[index]);
  return onScale(state.colour, (state.colour === "speed" ? now.speeds : now.clearances)[index]);
}
const colourOf = (index, now) => inText(vehicleColour(index, now));

const originals = new WeakMap();
function originalOf(material) {
  if (!originals.has(material)) originals.set(material, material.color.clone());
  return originals.get(material);
}

/** Every material below a path of the scene that has a colour. */
function materials(path) {
  const found = [];
  node(path)?.object.traverse(({ material }) => {
    for (const each of [material ?? []].flat()) if (each.color) found.push(each);
  });
  return found;
}

function theme(toDark) {
  document.documentElement.classList.toggle("dark", toDark);
  const [top, bottom] = toDark ? [[0.09, 0.11, 0.15], [0.03, 0.035, 0.05]] : [[0.87, 0.91, 0.96], [1, 1, 1]];
  viewer.set_property(["Background", "<object>"], "top_color", top);
  viewer.set_property(["Background", "<object>"], "bottom_color", bottom);
  viewer.set_property(["Lights", "AmbientLight", "<object>"], "intensity", toDark ? 1.9 : 1.4);
  paint();
}

/** Give all that is in the scene its colour, in the present theme and by what is asked. */
function paint() {
  for (const material of materials([])) material.color.copy(seen(originalOf(material)));
  paintTrails();
  for (const shell of shells) shell.material.color.copy(seen(shell.userData.colour));
  scale.parentElement.hidden = state.colour === "vehicle";
  if (state.colour !== "vehicle") {
    const [low, high] = told.ranges[state.colour];
    const unit = state.colour === "speed" ? "m/s" : "m";
    scale.style.background = `linear-gradient(90deg, ${SCALES[state.colour].join(", ")})`;
    scaleText.textContent = `${inDigits(low)} to ${inDigits(high, unit)}${state.colour === "speed" ? "" : " and more"}`;
  }
  update(true);
}

/** Pieces of trails have the colour of what was when they were flown; those of a fleet their own. */
function paintTrails() {
  if (state.colour === "vehicle" || told.light) return;
  const values = state.colour === "speed" ? told.speeds : told.clearances;
  told.vehicles.forEach(({ path }, index) => {
    for (const name of Object.keys(node(["trails", path])?.children ?? {})) {
      const middle = (Number(name) + 0.5) * told.step;
      const colour = onScale(state.colour, between(values[index], frameAt(middle)));
      for (const material of materials(["trails", path, name])) material.color.copy(colour);
    }
  });
}

// ---------------------------------------------------------------- legend

const SIGNS = {
  aircraft: ["path", { d: "M2 8 L18 8 M10 8 L6 2 M10 8 L6 14 M4 8 L3 5 M4 8 L3 11" }],
  quadrotor: ["path", { d: "M5 4 L15 12 M15 4 L5 12 M2 4h6 M12 4h6 M2 12h6 M12 12h6" }],
  ends: ["path", { d: "M4 8m-2 0a2 2 0 1 0 4 0a2 2 0 1 0 -4 0 M14 8m-4 0a4 4 0 1 0 8 0a4 4 0 1 0 -8 0", fill: "currentColor" }],
  goal: ["path", { d: "M10 3 L14 8 L10 13 L6 8 Z", fill: "currentColor" }],
  prediction: ["path", { d: "M1 13 Q8 2 19 4", "stroke-width": 1 }],
  obstacle: ["circle", { cx: 10, cy: 8, r: 6.5, fill: "#99a", stroke: "none", opacity: 0.7 }],
  unknown: ["circle", { cx: 10, cy: 8, r: 6.5, fill: "#99a", stroke: "none", opacity: 0.25 }],
  radius: ["circle", { cx: 10, cy: 8, r: 6, fill: "currentColor", stroke: "none", opacity: 0.25 }],
  shell: ["path", { d: "M6 8m-5 0a5 5 0 1 0 10 0a5 5 0 1 0 -10 0 M15 8m-4 0a4 5 0 1 0 8 0a4 5 0 1 0 -8 0", "stroke-width": 1 }],
    tube: ["path", { d: "M1 8 L19 8", "stroke-width": 9, opacity: 0.22 }],
  wind: ["path", { d: "M2 8 L17 8 M12 4 L18 8 L12 12" }],
};
const [form, line] = SIGNS[told.vehicles[0].airframe];
SIGNS.planned = [form, { ...line, opacity: 0.4 }];
const legend = element(panel, "section", "legend");
const scaleLine = element(legend, "div");
const scale = element(scaleLine, "span", "bar");
const scaleText = element(scaleLine, "span", "num");
for (const { sign, text } of told.legend) {
  const line = element(legend, "div");
  const svg = drawing(line, "svg", { viewBox: "0 0 20 16" });
  const [tag, attributes] = SIGNS[sign];
  drawing(svg, tag, { fill: "none", stroke: "currentColor", "stroke-width": 1.8, ...attributes });
  element(line, "span", "", text);
}

// ---------------------------------------------------------------- the scene

/** A node of Meshcat's tree below /flight; `find` of its own would make what is not there. */
function node(path) {
  return ["flight", ...path].reduce((found, name) => found?.children[name], viewer.scene_tree);
}

/** A place in the scenario's coordinates, z upwards, in those of the camera, y upwards. */
const inView = (x, y, z) => new THREE.Vector3(x, z, -y);
let nodes = [];
const placeOf = (index) => inView(...nodes[index].position.toArray());

const shells = [];
/** Half the separation around every vehicle; made when it is first asked for. */
function showShells(on) {
  if (on && shells.length === 0 && told.shell) {
    const ball = new THREE.SphereGeometry(1, told.light ? 12 : 32, told.light ? 8 : 20);
    const opacity = told.light ? 0.1 : 0.16;
    told.vehicles.forEach((_, index) => {
      const material = new THREE.MeshLambertMaterial({ transparent: true, opacity, depthWrite: false });
      const shell = new THREE.Mesh(ball, material);
      shell.scale.set(...told.shell);
      shell.userData.colour = own[index];
      node([]).object.add(shell);
      shells.push(shell);
    });
  }
  for (const shell of shells) shell.visible = on;
  paint();
}

for (const { title: words, paths } of told.layers) {
  const line = element(layers, "label");
  const box = element(line, "input");
  Object.assign(box, { type: "checkbox", checked: words !== "Shells" });
  box.dataset.layer = words;
  line.append(` ${words}`);
  box.addEventListener("change", () => show(words, box.checked));
  box.dataset.paths = paths.join(" ");
}
button(layers, "Meshcat's controls", "the scene's tree", () => document.body.classList.toggle("tree"));

function show(layer, on) {
  const box = [...layers.querySelectorAll("input")].find((each) => each.dataset.layer === layer);
  box.checked = on;
  if (layer === "Shells") showShells(on);
  if (layer === "Names") labels.hidden = !on;
  for (const path of box.dataset.paths.split(" ").filter(Boolean)) {
    if (node([path])) node([path]).object.visible = on;
  }
  viewer.set_dirty();
}

function colourVehicles(now) {
  told.vehicles.forEach((_, index) => {
    const colour = vehicleColour(index, now);
    for (const material of bodies[index]) material.color.copy(colour);
  });
}
let bodies = [];

// ---------------------------------------------------------------- cameras

/** What of the window is under cards at its sides [px]; above, tools may be, or in narrow ones below. */
function free() {
  const right = panel.offsetWidth ? innerWidth - panel.offsetLeft : 0;
  const bars = [tools, transport].filter((bar) => bar.offsetWidth);
  const [above, below] = [0, 1].map((low) => bars.filter((bar) => bar.offsetTop > innerHeight / 2 === Boolean(low)));
  const top = Math.max(10, ...above.map((bar) => bar.offsetTop + bar.offsetHeight));
  return { left: 0, top, right, bottom: innerHeight - Math.min(innerHeight - 10, ...below.map((bar) => bar.offsetTop)) };
}

function centred() {
  const { left, top, right, bottom } = free();
  const [wide, high] = [viewer.dom_element.offsetWidth, viewer.dom_element.offsetHeight];
  viewer.camera.setViewOffset(wide, high, (right - left) / 2, (bottom - top) / 2, wide, high);
  viewer.set_dirty();
}

function direction([azimuth, elevation]) {
  const [around, above] = [azimuth, elevation].map((degrees) => (degrees * Math.PI) / 180);
  return inView(Math.cos(around) * Math.cos(above), Math.sin(around) * Math.cos(above), Math.sin(above));
}

/**
 * From where all of the scene is seen in what is free of the window, and no further.
 *
 * A point that is `across` to one side and `depth` towards the camera is seen from the distance d
 * if |across - middle| <= k (d - depth), so the least d and its middle follow in closed form.
 */
function whole(towards) {
  const right = new THREE.Vector3(0, 1, 0).cross(towards).normalize();
  const up = towards.clone().cross(right);
  const { left, top, right: aside, bottom } = free();
  const [wide, high] = [viewer.dom_element.offsetWidth, viewer.dom_element.offsetHeight];
  const half = Math.tan((viewer.camera.fov * Math.PI) / 360);
  const points = told.outline.map((point) => inView(...point));
  const fit = (axis, size) => {
    const k = (half * size) / high;
    const most = points.reduce((found, point) => Math.max(found, point.dot(axis) + k * point.dot(towards)), -Infinity);
    const least = points.reduce((found, point) => Math.min(found, point.dot(axis) - k * point.dot(towards)), Infinity);
    return { distance: (most - least) / (2 * k), middle: (most + least) / 2 };
  };
  const across = fit(right, wide - left - aside - 90);
  const above = fit(up, high - top - bottom - 60);
  const nearest = points.reduce((found, point) => Math.max(found, point.dot(towards)), -Infinity);
  const distance = Math.max(across.distance, above.distance, nearest + told.seen);
  const depth = points.reduce((sum, point) => sum + point.dot(towards), 0) / points.length;
  const inPlane = right.clone().multiplyScalar(across.middle).addScaledVector(up, above.middle);
  return {
    target: inPlane.clone().addScaledVector(towards, depth), position: inPlane.addScaledVector(towards, distance),
  };
}

function moveCamera({ target, position }, seconds) {
  const { camera, controls } = viewer;
  const begin = { target: controls.target.clone(), position: camera.position.clone() };
  state.tween = { begin, end: { target, position }, part: seconds > 0 ? 0 : 1, seconds };
  stepCamera(0);
}

function stepCamera(elapsed) {
  const { tween } = state;
  if (!tween) return;
  tween.part = tween.seconds > 0 ? Math.min(1, tween.part + elapsed / tween.seconds) : 1;
  const eased = tween.part * tween.part * (3 - 2 * tween.part);
  viewer.controls.target.lerpVectors(tween.begin.target, tween.end.target, eased);
  viewer.camera.position.lerpVectors(tween.begin.position, tween.end.position, eased);
  if (tween.part === 1) state.tween = null;
  viewer.set_dirty();
}

/** Look from somewhere: at the vehicle that is followed, or else at the whole scene. */
function look(view, seconds = 0.5) {
  state.view = view;
  for (const [name, each] of Object.entries(views)) each.classList.toggle("on", name === view);
  centred();
  const towards = direction(VIEWS[view]);
  if (state.follow === null) return moveCamera(whole(towards), seconds);
  const target = placeOf(state.follow);
  const near = 16 * told.vehicles[state.follow].radius;
  moveCamera({ target, position: target.clone().addScaledVector(towards, near) }, seconds);
}

function follow(index, seconds = 0.5) {
  state.follow = index;
  followed.value = index ?? "";
  look(state.view, seconds);
  update(true);
}

/** Keep what is followed where it is in the window, from wherever the user looks at it. */
function keepFollowing() {
  if (state.follow === null) return;
  const place = placeOf(state.follow);
  if (state.tween) {
    const moved = place.clone().sub(state.tween.end.target);
    for (const each of Object.values(state.tween.end)) each.add(moved);
    stepCamera(0);
    return;
  }
  const moved = place.sub(viewer.controls.target);
  viewer.controls.target.add(moved);
  viewer.camera.position.add(moved);
}

// ---------------------------------------------------------------- names

/** Labels of vehicles, of a fleet only of the one that is followed, and of obstacles with names. */
const tags = [
  ...told.vehicles.map(({ label, radius }, index) => ({ text: label, vehicle: index, above: 0.6 * radius })),
  ...told.obstacles.map(({ label, above }, index) => ({ text: label, number: index + 1, above })),
].filter(({ text }) => text?.trim());

function tagShown({ vehicle }) {
  return vehicle === undefined || told.vehicles.length <= told.fleet || vehicle === state.follow;
}

function updateLabels() {
  const { camera } = viewer;
  camera.updateMatrixWorld();
  const [wide, high] = [viewer.dom_element.offsetWidth, viewer.dom_element.offsetHeight];
  const up = new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, 1);
  const placed = [];
  for (const tag of tags) {
    if (!tagShown(tag)) {
      tag.label?.remove();
      tag.mark?.remove();
      tag.label = tag.mark = null;
      continue;
    }
    if (!tag.label) {
      tag.label = element(labels, "div", tag.vehicle === undefined ? "label thing" : "label", tag.text);
      tag.width = tag.label.offsetWidth;
      if (tag.vehicle !== undefined) tag.mark = element(labels, "div", "mark");
    }
    const object = tag.vehicle === undefined ? node(["obstacles", String(tag.number)])?.object : nodes[tag.vehicle];
    if (!object) continue;
    const place = inView(...object.position.toArray());
    const shrunk = tag.above * (tag.vehicle === undefined ? 1 : object.scale.x);
    const at = place.clone().project(camera);
    const top = place.clone().addScaledVector(up, shrunk).project(camera);
    if (tag.mark) {
      // what is too small to be seen is marked where it is
      tag.mark.style.color = inText(bodies[tag.vehicle][0].color);
      tag.mark.hidden = ((top.y - at.y) / 2) * high > 5.5 || at.z > 1;
      tag.mark.style.transform = `translate(${((at.x + 1) / 2) * wide}px, ${((1 - at.y) / 2) * high}px)`;
    }
    const x = ((top.x + 1) / 2) * wide;
    let y = ((1 - top.y) / 2) * high - 25;
    const hidden = top.z > 1 || x < -50 || y < -50 || x > wide + 50 || y > high + 50;
    for (const other of hidden ? [] : placed) {
      if (Math.abs(other.x - x) < (other.width + tag.width) / 2 && Math.abs(other.y - y) < 15) y = other.y - 15;
    }
    if (!hidden) placed.push({ x, y, width: tag.width });
    Object.assign(tag, { x, y, hidden });
    tag.label.style.display = hidden ? "none" : "";
    tag.label.style.transform = `translate(${(x - tag.width / 2).toFixed(1)}px, ${y.toFixed(1)}px)`;
  }
}

// ---------------------------------------------------------------- time

let lastWritten = 0; // when the table was [ms]

/** Bring all to the present time; the table ten times a second, or at once. */
function update(atOnce = false) {
  viewer.animator.seek(state.time / told.rate);
  const now = readings();
  clockValue.textContent = now.time.toFixed(told.duration < 100 ? 2 : 1).replace("-", "−");
  slider.value = state.time;
  const written = performance.now();
  if (atOnce || written - lastWritten > 100) {
    lastWritten = written;
    updateTable(now, atOnce);
    const window = told.windows.findLastIndex((begin) => begin <= state.time + 1e-9) + 1;
    const pace = state.speed * told.rate;
    moment.textContent = [
      window ? `window ${window} of ${told.windows.length}` : "", pace === 1 ? "" : `${Number(pace.toPrecision(3))} × real time`,
    ].filter(Boolean).join(" · ");
  }
  updatePlots(now);
  if (state.colour !== "vehicle" || atOnce) colourVehicles(now);
  shells.forEach((shell, index) => shell.position.copy(nodes[index].position));
  keepFollowing();
  viewer.set_dirty();
}

function seek(time) {
  state.time = Math.min(told.duration, Math.max(0, time));
  update(true);
}

function play(on) {
  state.playing = on;
  playButton.textContent = on ? "❚❚" : "▶";
  if (on && state.time >= told.duration) seek(0);
}

function loop(on) {
  state.loop = on;
  loopButton.classList.toggle("on", on);
}

function colourBy(by) {
  state.colour = by;
  coloured.value = by;
  paint();
}

function fold(on) {
  document.body.classList.toggle("folded", on);
  look(state.view);
}

let before = null;
function tick(now) {
  const elapsed = before === null ? 0 : Math.min(0.2, (now - before) / 1000);
  before = now;
  stepCamera(elapsed);
  if (state.playing) {
    state.time += elapsed * state.speed * told.rate;
    if (state.time >= told.duration) {
      state.time = state.loop ? 0 : told.duration;
      if (!state.loop) play(false);
    }
    update();
  }
  requestAnimationFrame(tick);
}

const KEYS = {
  Space: () => play(!state.playing), ArrowLeft: () => seek(state.time - told.step), ArrowRight: () => seek(state.time + told.step),
  Home: () => seek(0), End: () => seek(told.duration), KeyL: () => loop(!state.loop), KeyD: () => theme(!dark()),
  KeyN: () => fold(!document.body.classList.contains("folded")), Escape: () => follow(null),
  Digit1: () => look("free"), Digit2: () => look("top"), Digit3: () => look("side"),
};

/** Meshcat's round things have corners; these have so many that they are not seen. */
function round() {
  node(["obstacles"])?.object.traverse((each) => {
    const { type, parameters } = each.geometry ?? {};
    if (type === "SphereGeometry") each.geometry = new THREE.SphereGeometry(parameters.radius, 64, 40);
    if (each.material?.flatShading && type === "SphereGeometry") {
      each.material.flatShading = false;
      each.material.needsUpdate = true;
    }
  });
}

function begin() {
  viewer.animator.pause();
  round();
  nodes = told.vehicles.map(({ path }) => node(["vehicles", path]).object);
  bodies = told.vehicles.map(({ path }) => materials(["vehicles", path]));
  viewer.render_callback = updateLabels;
  end.textContent = `${inDigits(told.start + told.duration)} s`;
  addEventListener("resize", centred);
  addEventListener("keydown", (event) => {
    if (event.target.tagName === "SELECT" || event.ctrlKey || event.metaKey || !KEYS[event.code]) return;
    event.preventDefault();
    KEYS[event.code]();
  });
  if (told.shell) showShells(false);
  if (innerWidth <= 700) document.body.classList.add("folded");
  loop(true);
  play(true);
  theme(matchMedia("(prefers-color-scheme: dark)").matches);
  look("free", 0);
  requestAnimationFrame(tick);
  window.drakeRho = {
    seek, play, loop, look, follow, colourBy, show, theme, fold, readings, tags, told,
    /** Draw a time at once as a frame of a film, without controls, that plays at some rate. */
    frame(time, rate) {
      if (!state.film) {
        state.film = true;
        state.speed = rate / told.rate;
        play(false);
        document.body.classList.add("film");
        look(state.view, 0);
      }
      seek(time);
      viewer.render();
    },
  };
}

/** Begin when Meshcat has the whole scene: every vehicle, and its recording. */
(function wait() {
  const there = viewer.animator.actions.length > 0 && told.vehicles.every(({ path }) => node(["vehicles", path]));
  if (there) begin();
  else setTimeout(wait, 30);
})();
