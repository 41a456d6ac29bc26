// Colours, in both themes, and the legend.

// ---------------------------------------------------------------- colours and themes

const dark = () => document.documentElement.classList.contains("dark");

/** Return a colour for the current background: on a dark one greys are inverted, dark colours lightened. */
function seen(colour) {
  if (!dark()) return colour;
  const hsl = colour.getHSL({}, "srgb");
  if (hsl.s < 0.15) return colour.clone().setHSL(hsl.h, hsl.s, hsl.l > 0.7 ? 0.22 : hsl.l > 0.5 ? 0.45 : 0.85, "srgb");
  return colour.clone().setHSL(hsl.h, hsl.s, Math.max(hsl.l, 0.55), "srgb");
}

function onScale(by, value) {
  return onStops(SCALES[by], data.ranges[by], value);
}

function onStops(stops, [low, high], value) {
  const place = Math.min(1, Math.max(0, ((value ?? high) - low) / (high - low || 1))) * (stops.length - 1);
  const first = Math.min(Math.floor(place), stops.length - 2);
  return new THREE.Color(stops[first]).lerp(new THREE.Color(stops[first + 1]), place - first);
}

const own = data.vehicles.map(({ colour }) => new THREE.Color(colour));
const inText = (colour) => `#${colour.getHexString()}`;

function vehicleColour(index, now) {
  if (state.colour === "vehicle") return seen(own[index]);
  if (state.colour === "lights") return lightOf(index);
  return onScale(state.colour, (state.colour === "speed" ? now.speeds : now.clearances)[index]);
}

/** Return the colour of a vehicle's light at the current time, the greyer the dimmer it is. */
function lightOf(index) {
  const { times, colours } = data.lights[index];
  const light = colours.map((values) => between(values, frameAt(state.time, times)));
  const shine = Math.max(...light);
  const colour = new THREE.Color().setRGB(...light.map((value) => value / (shine || 1)), "srgb");
  return unlit().lerp(colour, shine);
}
const unlit = () => new THREE.Color(dark() ? "#3c4454" : "#a4adbb");
const colourOf = (index, now) => inText(vehicleColour(index, now));

const originals = new WeakMap();
function originalOf(material) {
  if (!originals.has(material)) originals.set(material, material.color.clone());
  return originals.get(material);
}

/** Return all coloured materials below a path of the scene. */
function materials(path) {
  const found = [];
  node(path)?.object.traverse(({ material }) => {
    for (const each of [material ?? []].flat()) if (each.color) found.push(each);
  });
  return found;
}

function theme(toDark) {
  document.documentElement.classList.toggle("dark", toDark);
  press(themeButton, toDark);
  const [top, bottom] = toDark ? [[0.09, 0.11, 0.15], [0.03, 0.035, 0.05]] : [[0.87, 0.91, 0.96], [1, 1, 1]];
  viewer.set_property(["Background", "<object>"], "top_color", top);
  viewer.set_property(["Background", "<object>"], "bottom_color", bottom);
  viewer.set_property(["Lights", "AmbientLight", "<object>"], "intensity", toDark ? 1.9 : 1.4);
  paint();
}

/** Colour the whole scene for the current theme and colour scale. */
function paint() {
  for (const material of materials([])) material.color.copy(seen(originalOf(material)));
  paintTrails();
  for (const shell of shells) shell.material.color.copy(seen(shell.userData.colour));
  scale.parentElement.hidden = !data.ranges[state.colour];
  if (data.ranges[state.colour]) {
    const [low, high] = data.ranges[state.colour];
    const unit = state.colour === "speed" ? "m/s" : "m";
    scale.style.background = `linear-gradient(90deg, ${SCALES[state.colour].join(", ")})`;
    scaleText.textContent = `${inDigits(low)} to ${inDigits(high, unit)}${state.colour === "speed" ? "" : " and more"}`;
  }
  update(true);
}

/** Colour pieces of trails by the values when they were flown; large fleets keep their colours. */
function paintTrails() {
  if (!data.ranges[state.colour] || data.light) return;
  const values = state.colour === "speed" ? data.speeds : data.clearances;
  data.vehicles.forEach(({ path }, index) => {
    for (const name of Object.keys(node(["trails", path])?.children ?? {})) {
      const middle = (Number(name) + 0.5) * data.step;
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
  light: ["circle", { cx: 10, cy: 8, r: 5, fill: "#ffb000", stroke: "#a4adbb", "stroke-width": 2 }],
  goal: ["path", { d: "M10 3 L14 8 L10 13 L6 8 Z", fill: "currentColor" }],
  prediction: ["path", { d: "M1 13 Q8 2 19 4", "stroke-width": 1 }],
  measured: ["path", { d: "M1 12 Q8 3 19 6", stroke: "#202020", "stroke-width": 1 }],
  contingency: ["path", { d: "M1 13 Q8 4 15 4 M13 2 L17 6 M17 2 L13 6", stroke: "#b3541e", "stroke-width": 1.2 }],
  link: ["path", { d: "M1 8 L19 8", stroke: data.reddening[0], "stroke-width": 2.4 }],
  set: ["path", { d: "M3 3 H17 V13 H3 Z", stroke: "#2e8b57", fill: "#2e8b5733", "stroke-width": 1.2 }],
  obstacle: ["circle", { cx: 10, cy: 8, r: 6.5, fill: "#99a", stroke: "none", opacity: 0.7 }],
  map: ["path", { d: "M2 13 V8 H7 V3 H13 V6 H18 V13 Z", fill: data.heights[1], stroke: data.heights[0], "stroke-width": 1.2 }],
  unknown: ["circle", { cx: 10, cy: 8, r: 6.5, fill: "#99a", stroke: "none", opacity: 0.25 }],
  radius: ["circle", { cx: 10, cy: 8, r: 6, fill: "currentColor", stroke: "none", opacity: 0.25 }],
  shell: ["path", { d: "M6 8m-5 0a5 5 0 1 0 10 0a5 5 0 1 0 -10 0 M15 8m-4 0a4 5 0 1 0 8 0a4 5 0 1 0 -8 0", "stroke-width": 1 }],
  tube: ["path", { d: "M1 8 L19 8", "stroke-width": 9, opacity: 0.22 }],
  conflict: ["circle", { cx: 10, cy: 8, r: 6, fill: "#d00000", stroke: "none", opacity: 0.5 }],
  wind: ["path", { d: "M2 8 L17 8 M12 4 L18 8 L12 12" }],
};
const [form, line] = SIGNS[data.vehicles[0].airframe];
SIGNS.planned = [form, { ...line, opacity: 0.4 }];
const legend = element(panel, "section", "legend");
const scaleLine = element(legend, "div");
const scale = element(scaleLine, "span", "bar");
const scaleText = element(scaleLine, "span", "num");
for (const { sign, text } of data.legend) {
  const line = element(legend, "div");
  const svg = drawing(line, "svg", { viewBox: "0 0 20 16", "aria-hidden": true });
  const [tag, attributes] = SIGNS[sign];
  drawing(svg, tag, { fill: "none", stroke: "currentColor", "stroke-width": 1.8, ...attributes });
  element(line, "span", "", text);
}
