// Scene: separation shells, cameras and labels.

// ---------------------------------------------------------------- the scene

/** Return a node of Meshcat's tree below /flight; Meshcat's `find` would create missing nodes. */
function node(path) {
  return ["flight", ...path].reduce((found, name) => found?.children[name], viewer.scene_tree);
}

/** Convert coordinates of the scenario (z up) to those of the camera (y up). */
const inView = (x, y, z) => new THREE.Vector3(x, z, -y);
let nodes = [];
const placeOf = (index) => inView(...nodes[index].position.toArray());

const shells = [];
/** Show or hide shells of half the separation around all vehicles; they are made on first use. */
function showShells(on) {
  if (on && shells.length === 0 && data.shell) {
    const ball = new THREE.SphereGeometry(1, data.light ? 12 : 32, data.light ? 8 : 20);
    const opacity = data.light ? 0.1 : 0.16;
    data.vehicles.forEach((_, index) => {
      const material = new THREE.MeshLambertMaterial({ transparent: true, opacity, depthWrite: false });
      const shell = new THREE.Mesh(ball, material);
      shell.scale.set(...data.shell);
      shell.userData.colour = own[index];
      node([]).object.add(shell);
      shells.push(shell);
    });
  }
  for (const shell of shells) shell.visible = on;
  paint();
}

for (const { title: words, paths } of data.layers) {
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
  data.vehicles.forEach((_, index) => {
    const colour = vehicleColour(index, now);
    const shines = state.colour === "lights";
    for (const material of bodies[index]) material.color.copy(shines ? unlit() : colour);
    lamps[index]?.material.color.copy(colour);
    if (lamps[index]) lamps[index].visible = shines;
    shown[index] = colour;
  });
}

const lamps = [];
/** Put a light on every vehicle of a show. */
function addLamps() {
  const ball = new THREE.SphereGeometry(1, 16, 12);
  data.lights.forEach((_, index) => {
    const lamp = new THREE.Mesh(ball, new THREE.MeshBasicMaterial({ fog: false, toneMapped: false }));
    lamp.scale.setScalar(0.7 * data.vehicles[index].radius);
    node([]).object.add(lamp);
    lamps.push(lamp);
  });
}
let bodies = [];
const shown = []; // colours of the vehicles

// ---------------------------------------------------------------- cameras

/**
 * Return the widths covered by cards at the edges of the window [px].
 *
 * The headline is above the scene, in low windows to its left; in narrow ones the tools are below.
 */
function free() {
  const [head, numbers, ...bars] = [title, panel, tools, transport].map((card) => card.getBoundingClientRect());
  const wide = ({ width }) => width > innerWidth / 2;
  const low = innerHeight < LOW;
  const isBelow = (bar) => bar.top + bar.bottom > innerHeight;
  const shown = bars.filter((bar) => bar.width);
  const below = [...shown.filter(isBelow), ...(wide(numbers) ? [numbers] : [])]; // on phones the numbers are a sheet
  const above = [...shown.filter((bar) => !isBelow(bar)), ...(low ? [] : [head])];
  return {
    left: low ? head.right : 0, right: numbers.width && !wide(numbers) ? innerWidth - numbers.left : 0,
    top: Math.max(10, ...above.map((bar) => bar.bottom)),
    bottom: innerHeight - Math.min(innerHeight - 10, ...below.map((bar) => bar.top)),
  };
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
 * Return the nearest camera position from which the whole scene fits into the free part of the window.
 *
 * A point at `across` sideways and `depth` towards the camera is visible from a distance d if
 * |across - middle| <= k (d - depth), so the least d and its middle follow in closed form.
 */
function whole(towards) {
  const right = new THREE.Vector3(0, 1, 0).cross(towards).normalize();
  const up = towards.clone().cross(right);
  const { left, top, right: aside, bottom } = free();
  const [wide, high] = [viewer.dom_element.offsetWidth, viewer.dom_element.offsetHeight];
  const half = Math.tan((viewer.camera.fov * Math.PI) / 360);
  const points = data.outline.map((point) => inView(...point));
  const fit = (axis, size) => {
    const k = (half * size) / high;
    const most = points.reduce((found, point) => Math.max(found, point.dot(axis) + k * point.dot(towards)), -Infinity);
    const least = points.reduce((found, point) => Math.min(found, point.dot(axis) - k * point.dot(towards)), Infinity);
    return { distance: (most - least) / (2 * k), middle: (most + least) / 2 };
  };
  const across = fit(right, wide - left - aside - 90);
  const above = fit(up, high - top - bottom - 60);
  const nearest = points.reduce((found, point) => Math.max(found, point.dot(towards)), -Infinity);
  const distance = Math.max(across.distance, above.distance, nearest + data.seen);
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

/** Set a view of the followed vehicle or, if there is none, of the whole scene. */
function look(view, seconds = 0.5) {
  state.view = view;
  for (const [name, each] of Object.entries(views)) press(each, name === view);
  centred();
  const towards = direction(VIEWS[view]);
  if (state.follow === null) return moveCamera(whole(towards), seconds);
  const target = placeOf(state.follow);
  const near = 16 * data.vehicles[state.follow].radius;
  moveCamera({ target, position: target.clone().addScaledVector(towards, near) }, seconds);
}

function follow(index, seconds = 0.5) {
  state.follow = index;
  followed.value = index ?? "";
  look(state.view, seconds);
  update(true);
}

/** Move the camera with the followed vehicle, in whatever view the user has chosen. */
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

// ---------------------------------------------------------------- scale and axes

const gauge = element(overlay, "div", "gauge");
gauge.setAttribute("aria-hidden", true);
const triad = drawing(gauge, "svg", { viewBox: "-26 -26 52 52" });
const AXES = ["x", "y", "z"].map((name) => ({ line: drawing(triad, "line"), text: drawing(triad, "text"), name }));
for (const { text, name } of AXES) text.textContent = name;
const scaleBar = element(gauge, "div", "scale");
const scaleWords = element(scaleBar, "div", "num");
const scaleLength = element(scaleBar, "div", "length");

/** Return the largest of 1, 2 and 5 times a power of ten that is at most a length. */
function roundLength(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return power * [5, 2, 1].find((digit) => digit * power <= most * (1 + 1e-9));
}

/** Draw the axes as the camera sees them, and a scale bar that is exact at the point it looks at. */
function updateGauge() {
  const { camera, controls } = viewer;
  AXES.forEach(({ line, text }, index) => {
    const unit = inView(...[0, 1, 2].map((axis) => Number(axis === index)));
    const { x, y } = unit.transformDirection(camera.matrixWorldInverse);
    line.setAttribute("x2", 17 * x);
    line.setAttribute("y2", -17 * y);
    text.setAttribute("x", 24 * x);
    text.setAttribute("y", -24 * y);
    text.style.opacity = Math.hypot(x, y) < 0.2 ? 0 : 1;
  });
  const distance = camera.position.distanceTo(controls.target);
  const perPixel = (2 * distance * Math.tan((camera.fov * Math.PI) / 360)) / viewer.dom_element.offsetHeight;
  const length = roundLength(120 * perPixel);
  scaleWords.textContent = length >= 1000 ? `${length / 1000} km` : `${Number(length.toPrecision(1))} m`;
  scaleLength.style.width = `${length / perPixel}px`;
  gauge.style.bottom = `${Math.max(16, free().bottom + 10)}px`;
}

// ---------------------------------------------------------------- names

/** Labels of vehicles (in large fleets only of the followed one) and of named obstacles. */
const tags = [
  ...data.vehicles.map(({ label, radius }, index) => ({ text: label, vehicle: index, above: 0.6 * radius })),
  ...data.obstacles.map(({ label, above }, index) => ({ text: label, number: index + 1, above })),
].filter(({ text }) => text?.trim());

function tagShown({ vehicle }) {
  return vehicle === undefined || data.vehicles.length <= data.fleet || vehicle === state.follow;
}

/** Add a tag's label to the page, and a vehicle's mark, or remove them. */
function attach(tag) {
  const shown = tagShown(tag);
  if (shown && !tag.label) {
    tag.label = element(labels, "div", tag.vehicle === undefined ? "label thing" : "label", tag.text);
    [tag.width, tag.height] = [tag.label.offsetWidth, tag.label.offsetHeight];
    if (tag.vehicle !== undefined) tag.mark = element(labels, "div", "mark");
  }
  if (!shown && tag.label) {
    tag.label.remove();
    tag.mark?.remove();
    tag.label = tag.mark = tag.hidden = null;
  }
}

/** Return the labelled tags by rank: the followed vehicle, those with the least clearance, obstacles. */
function ranked() {
  const at = frameAt(state.time);
  const lead = 0.1 * (data.ranges.clearance?.[1] ?? 1); // of a shown name over a hidden one, so that none flickers
  const rank = ({ vehicle, hidden }) => {
    if (vehicle === undefined) return Infinity;
    if (vehicle === state.follow) return -Infinity;
    return (between(data.clearances[vehicle], at) ?? Number.MAX_VALUE) - (hidden === false ? lead : 0);
  };
  const found = tags.filter(({ label }) => label).map((tag) => ({ tag, rank: rank(tag) }));
  return found.sort((one, other) => one.rank - other.rank || 0).map(({ tag }) => tag);
}

/** Return whether a name would overlap another; a hidden one needs some more room to come back. */
function meets(tag, x, y, other) {
  const gap = tag.hidden === false ? 1 : 8;
  const beside = Math.abs(other.x - x) >= (other.width + tag.width) / 2 + gap;
  return !beside && Math.abs(other.y - y) < (other.height + tag.height) / 2 + gap;
}

/** Place names above vehicles and obstacles; of those that would overlap only the first in rank is shown. */
function updateLabels() {
  const { camera } = viewer;
  camera.updateMatrixWorld();
  updateGauge();
  const [wide, high] = [viewer.dom_element.offsetWidth, viewer.dom_element.offsetHeight];
  const up = new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, 1);
  const placed = [];
  tags.forEach(attach);
  for (const tag of ranked()) {
    const object = tag.vehicle === undefined ? node(["obstacles", String(tag.number)])?.object : nodes[tag.vehicle];
    if (!object) continue;
    const place = inView(...object.position.toArray());
    const shrunk = tag.above * (tag.vehicle === undefined ? 1 : object.scale.x);
    const at = place.clone().project(camera);
    const top = place.clone().addScaledVector(up, shrunk).project(camera);
    if (tag.mark) {
      // vehicles that are too small to be visible get a mark
      tag.mark.style.color = inText(shown[tag.vehicle] ?? bodies[tag.vehicle][0].color);
      tag.mark.hidden = ((top.y - at.y) / 2) * high > 5.5 || at.z > 1;
      tag.mark.style.transform = `translate(${((at.x + 1) / 2) * wide}px, ${((1 - at.y) / 2) * high}px)`;
    }
    const x = ((top.x + 1) / 2) * wide;
    const y = ((1 - top.y) / 2) * high - 25;
    const gone = tag.vehicle === undefined && !object.visible; // an obstacle that is not active now
    const away = gone || top.z > 1 || x < -50 || y < -50 || x > wide + 50 || y > high + 50;
    const hidden = away || placed.some((other) => meets(tag, x, y, other));
    Object.assign(tag, { x, y, hidden });
    if (!hidden) placed.push(tag);
    tag.label.style.display = hidden ? "none" : "";
    tag.label.style.transform = `translate(${(x - tag.width / 2).toFixed(1)}px, ${y.toFixed(1)}px)`;
  }
}
