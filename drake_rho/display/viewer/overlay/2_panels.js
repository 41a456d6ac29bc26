// Panels beside the scene: time, table of vehicles, plots and controls.

// ---------------------------------------------------------------- title, tools, transport

const title = card("header", "headline", "time");
element(title, "h1", "", data.name).title = data.name;
const clock = element(title, "div", "clock num");
const clockValue = element(clock, "span");
element(clock, "small", "", "s");
const moment = element(title, "div", "soft num");

const tools = card("section", "tools", "camera and display");
const views = Object.fromEntries(
  Object.keys(VIEWS).map((name, index) => [
    name,
    button(tools, name[0].toUpperCase() + name.slice(1), `camera: ${name} (${index + 1})`, () => look(name)),
  ]),
);
const followed = choice(
  tools, "follow a vehicle", [["", "Follow…"], ...data.vehicles.map(({ label }, index) => [index, label])],
  (value) => follow(value === "" ? null : Number(value)),
);
const coloured = choice(
  tools, "colour by",
  ["vehicle", ...(data.lights.length ? ["lights"] : []), ...Object.keys(data.ranges)].map((by) => [by, `Colour: ${by}`]),
  colourBy,
);
coloured.value = state.colour;
const menu = element(tools, "div", "menu");
const opener = button(menu, "Show ▾", "layers", () => opener.setAttribute("aria-expanded", menu.classList.toggle("open")));
opener.setAttribute("aria-expanded", false);
const layers = element(menu, "div", "card");
const themeButton = button(tools, "◐", "light or dark (d)", () => theme(!dark()));
const foldButton = button(tools, "▤", "numbers (n)", () => fold(!document.body.classList.contains("folded")));

const transport = card("section", "transport", "playback");
const playButton = button(transport, "", "play or pause (space)", () => play(!state.playing));
playButton.className = "play";
const bar = element(transport, "div", "bar");
const slider = element(bar, "input");
Object.assign(slider, { type: "range", min: 0, max: data.duration, step: "any" });
called(slider, "time");
slider.addEventListener("input", () => seek(Number(slider.value)));
const chapters = element(bar, "div", "scenes"); // the scenes of a show, each named where it begins
chapters.hidden = data.scenes.length === 0;
document.body.classList.toggle("staged", data.scenes.length > 0);
data.scenes.forEach(({ name, begin, end: last }, index) => {
  const share = (time) => `${(100 * time) / data.duration}%`;
  const next = data.scenes[index + 1]?.begin ?? data.duration;
  const chapter = button(chapters, name, `scene: ${name}`, () => seek(begin));
  Object.assign(chapter.style, { left: share(begin), maxWidth: share(next - begin) });
  Object.assign(element(chapters, "i").style, { left: share(begin), width: share(last - begin) });
});
const end = element(transport, "span", "soft num");
choice(transport, "speed", SPEEDS.map((speed) => [speed, `${speed} ×`]), (value) => (state.speed = Number(value))).value = 1;
const loopButton = button(transport, "↻", "repeat (l)", () => loop(!state.loop));

// ---------------------------------------------------------------- vehicles

const panel = card("aside", "panel", "numbers");
const scroller = element(panel, "div", "rows");
const table = element(scroller, "table");
const heads = element(element(table, "thead"), "tr");
const COLUMNS = { order: "vehicle", speed: "speed\n[m/s]", clearance: "clearance\n[m]" };
for (const [key, text] of Object.entries(COLUMNS)) {
  const head = element(heads, "th");
  head.dataset.key = key;
  button(head, text, "sort", () => {
    state.descending = state.sort === key ? !state.descending : key === "speed";
    state.sort = key;
    update(true);
  });
}
const body = element(table, "tbody");
const more = button(panel, "fold", "all vehicles", () => {
  state.unfolded = !state.unfolded;
  update(true);
});
more.className = "more";
more.hidden = data.vehicles.length <= FOLDED + 4;

const rows = [];
function row(place) {
  if (rows[place]) return rows[place];
  const line = element(body, "tr");
  const name = element(element(line, "td"), "button"); // its click is the row's
  const made = {
    line, button: name, swatch: element(name, "i"), name: element(name, "span"),
    speed: element(line, "td", "num"), clearance: element(line, "td", "num"), vehicle: -1,
  };
  line.addEventListener("click", () => follow(state.follow === made.vehicle ? null : made.vehicle));
  return (rows[place] = made);
}

function sorted(now) {
  const order = data.vehicles.map((_, index) => index);
  const values = { speed: now.speeds, clearance: now.clearances }[state.sort];
  const key = values ? (index) => values[index] ?? Infinity : (index) => index;
  return order.sort((one, other) => (key(one) - key(other) || one - other) * (state.descending ? -1 : 1));
}

function updateTable(now, atOnce) {
  if (atOnce || performance.now() - ordered > 1000) {
    order = sorted(now); // once a second, so that the table can be read
    ordered = performance.now();
  }
  const shown = state.film ? state.most : state.unfolded ? order.length : FOLDED;
  for (const head of heads.children) {
    const active = head.dataset.key === state.sort;
    head.setAttribute("aria-sort", active ? (state.descending ? "descending" : "ascending") : "none");
  }
  for (let place = 0; place < shown; place += 1) {
    const index = order[place];
    const each = row(place);
    if (each.vehicle !== index) {
      each.vehicle = index;
      each.name.textContent = data.vehicles[index].label;
    }
    const clear = now.clearances[index];
    each.swatch.style.background = colourOf(index, now);
    each.speed.textContent = inDigits(now.speeds[index]);
    each.clearance.textContent = inDigits(clear);
    each.clearance.classList.toggle("bad", clear !== null && clear < -data.tolerance);
    each.line.title = data.vehicles[index].name + (clear === null ? "" : ` – nearest: ${nearestName(now.nearest[index])}`);
    each.line.classList.toggle("followed", state.follow === index);
    press(each.button, state.follow === index);
    each.line.hidden = false;
  }
  for (let place = shown; place < rows.length; place += 1) rows[place].line.hidden = true;
  more.textContent = state.film
    ? `${shown} of ${order.length} vehicles, least clearance first`
    : state.unfolded ? "fold" : `all ${order.length} vehicles`;
}

/** Show the whole table and the legend in a film, where nobody can scroll, as small as they need to be. */
function fitPanel() {
  const tall = innerHeight > innerWidth; // numbers below the scene
  document.body.classList.toggle("tall", tall);
  const room = (tall ? 0.5 : 1) * innerHeight - 28;
  state.most = order.length;
  update(true);
  const line = (table.offsetHeight - heads.offsetHeight) / order.length;
  const fitting = Math.floor((room / SMALLEST - (panel.offsetHeight - order.length * line)) / line) - 1;
  more.hidden = fitting >= order.length;
  if (!more.hidden) {
    state.most = Math.max(1, fitting);
    state.sort = "clearance";
    update(true);
  }
  panel.style.transform = `scale(${Math.min(1, room / panel.offsetHeight)})`;
}

// ---------------------------------------------------------------- requirements

const left = element(panel, "section", "left");
left.hidden = data.requirements.length === 0;
panel.classList.toggle("asked", !left.hidden);
const leftHead = element(left, "header");
element(leftHead, "span", "", "requirement");
element(leftHead, "span", "", "left [m]").title = "distance from the boundary of the set";
const leftRows = data.requirements.map(({ label, title }) => {
  const line = element(left, "div");
  line.title = title;
  const swatch = element(line, "i");
  element(line, "span", "", label);
  return { line, swatch, value: element(line, "b", "num") };
});

/** Show what is left of each requirement, faint while it is not active. */
function updateLeft(now) {
  leftRows.forEach(({ line, swatch, value }, index) => {
    const present = now.left[index];
    const colour = onStops(data.reddening, [0, data.requirements[index].plenty], present);
    line.classList.toggle("soft", present === null);
    swatch.style.background = inText(seen(colour));
    value.textContent = inDigits(present);
    value.classList.toggle("bad", present !== null && present < -data.tolerance);
  });
}

// ---------------------------------------------------------------- plots

const WIDE = 264;
const HIGH = 74;
const plots = data.curves.map((curve) => {
  const box = element(panel, "section", "plot");
  const header = element(box, "header");
  element(header, "span", "", curve.title).title = curve.how;
  const value = element(header, "b", "num");
  const svg = drawing(box, "svg", { viewBox: `0 0 ${WIDE} ${HIGH}`, preserveAspectRatio: "none", "aria-hidden": true });
  const [when, least] = curve.least;
  const highest = curve.values.reduce((most, value) => Math.max(most, value ?? most), curve.limit ?? 0);
  const bottom = Math.min(least, curve.limit ?? 0);
  const lowest = bottom - (curve.limit === null ? 0 : 0.12 * (highest - bottom));
  const x = (time) => (time / data.duration) * WIDE;
  const y = (height) => HIGH - 4 - ((height - lowest) / (highest - lowest || 1)) * (HIGH - 10);
  drawing(svg, "path", { class: "curve", d: path(curve, x, y) });
  if (curve.limit !== null) {
    drawing(svg, "rect", { class: "forbidden", x: 0, width: WIDE, y: y(curve.limit), height: HIGH - y(curve.limit) });
    drawing(svg, "line", { class: "limit", x1: 0, x2: WIDE, y1: y(curve.limit), y2: y(curve.limit) });
  }
  drawing(svg, "circle", { class: "lowest", cx: x(when), cy: y(least), r: 3.2 });
  const now = drawing(svg, "line", { class: "now", y1: 0, y2: HIGH });
  const drag = (event) => {
    if (event.buttons === 1) seek(((event.clientX - svg.getBoundingClientRect().left) / svg.clientWidth) * data.duration);
  };
  svg.addEventListener("pointerdown", drag);
  svg.addEventListener("pointermove", drag);
  const knots = data.knotsOnly ? ", checked at the knots only" : "";
  const limit = curve.limit === null ? "no separation required" : `limit ${curve.limit}\u00a0m${knots}`;
  const [one, other] = curve.closest;
  const [size, moment] = [inDigits(least, "m"), inDigits(data.start + when, "s")];
  element(box, "footer", "", `least ${size} at ${moment}, ${one} – ${other}; ${limit}`);
  if (curve.how) element(box, "footer", "", curve.how);
  if (curve.limit !== null) {
    // the headline has it too, so that it is seen without the panel
    const short = element(title, "div", "least num", `${curve.title.toLowerCase()} `);
    const broken = least < curve.limit - data.tolerance;
    element(short, "b", broken ? "bad" : "", size);
    short.append(` at ${moment}${broken ? knots : ""}`);
  }
  return { curve, value, now, x };
});

/** Return the SVG path of a curve, with gaps where it has no value. */
function path(curve, x, y) {
  let pen = "M";
  return thinned(curve)
    .map((m) => {
      const value = curve.values[m];
      const step = value === null ? "" : `${pen}${x(curve.times[m]).toFixed(1)},${y(value).toFixed(2)}`;
      pen = value === null ? "M" : "L";
      return step;
    })
    .join("");
}

/** Return the points of a curve to plot: the lowest and the highest of each pixel. */
function thinned({ times, values }) {
  const bins = new Map();
  values.forEach((value, m) => {
    const bin = Math.floor((times[m] / data.duration) * WIDE * 2);
    const [low, high] = bins.get(bin) ?? [m, m];
    if (value === null || values[low] === null) bins.set(bin, [m, m]);
    else bins.set(bin, [value < values[low] ? m : low, value > values[high] ? m : high]);
  });
  return [...bins.values()].flatMap(([low, high]) => (low === high ? [low] : [low, high].sort((a, b) => a - b)));
}

function updatePlots(now) {
  plots.forEach(({ curve, value, now: line, x }, index) => {
    const present = now.curves[index];
    value.textContent = inDigits(present, "m");
    value.classList.toggle("bad", curve.limit !== null && present !== null && present < curve.limit - data.tolerance);
    line.setAttribute("x1", x(state.time));
    line.setAttribute("x2", x(state.time));
  });
}
