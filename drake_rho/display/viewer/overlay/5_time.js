// Time: playback, keys and the update of everything shown.

let lastWritten = 0; // time at which the table was last updated [ms]

/** Update everything to the current time; the table ten times a second, or at once. */
function update(atOnce = false) {
  viewer.animator.seek(state.time / data.rate);
  const now = readings();
  clockValue.textContent = now.time.toFixed(data.duration < 100 ? 2 : 1).replace("-", "−");
  slider.value = state.time;
  slider.setAttribute("aria-valuetext", `${clockValue.textContent} s`);
  const written = performance.now();
  if (atOnce || written - lastWritten > 100) {
    lastWritten = written;
    updateTable(now, atOnce);
    updateLeft(now);
    const window = data.windows.findLastIndex((begin) => begin <= state.time + 1e-9) + 1;
    const pace = state.speed * data.rate;
    const scene = data.scenes.findLast(({ begin, end }) => begin - 1e-9 <= state.time && state.time <= end + 1e-9);
    const next = scene ?? data.scenes.find(({ begin }) => begin > state.time);
    moment.textContent = [
      data.notice, scene ? scene.name : next ? `to ${next.name}` : data.scenes.length ? "landing" : "",
      window ? `window ${window} of ${data.windows.length}` : "", pace === 1 ? "" : `${Number(pace.toPrecision(3))} × real time`,
    ].filter(Boolean).join(" · ");
  }
  updatePlots(now);
  if (state.colour !== "vehicle" || atOnce) colourVehicles(now);
  for (const balls of [shells, lamps]) balls.forEach((ball, index) => ball.position.copy(nodes[index].position));
  keepFollowing();
  viewer.set_dirty();
}

function seek(time) {
  state.time = Math.min(data.duration, Math.max(0, time));
  update(true);
}

function play(on) {
  state.playing = on;
  playButton.textContent = on ? "❚❚" : "▶";
  if (on && state.time >= data.duration) seek(0);
}

function loop(on) {
  state.loop = on;
  press(loopButton, on);
}

function colourBy(by) {
  state.colour = by;
  coloured.value = by;
  paint();
}

function fold(on) {
  document.body.classList.toggle("folded", on);
  press(foldButton, !on);
  look(state.view);
}

let before = null;
function tick(now) {
  const elapsed = before === null ? 0 : Math.min(0.2, (now - before) / 1000);
  before = now;
  stepCamera(elapsed);
  if (state.playing) {
    state.time += elapsed * state.speed * data.rate;
    if (state.time >= data.duration) {
      state.time = state.loop ? 0 : data.duration;
      if (!state.loop) play(false);
    }
    update();
  }
  requestAnimationFrame(tick);
}

const KEYS = {
  Space: () => play(!state.playing), ArrowLeft: () => seek(state.time - data.step), ArrowRight: () => seek(state.time + data.step),
  Home: () => seek(0), End: () => seek(data.duration), KeyL: () => loop(!state.loop), KeyD: () => theme(!dark()),
  KeyN: () => fold(!document.body.classList.contains("folded")), Escape: () => follow(null),
  Digit1: () => look("free"), Digit2: () => look("top"), Digit3: () => look("side"),
};

/** Replace Meshcat's coarse spheres by finer ones. */
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
  nodes = data.vehicles.map(({ path }) => node(["vehicles", path]).object);
  bodies = data.vehicles.map(({ path }) => materials(["vehicles", path]));
  viewer.render_callback = updateLabels;
  end.textContent = `${inDigits(data.start + data.duration)} s`;
  addEventListener("resize", centred);
  // what a pointer has pressed is not in focus, so that the space bar plays; clicks of keys have no detail
  overlay.addEventListener("click", ({ target, detail }) => detail > 0 && target.closest("button, [type=checkbox]")?.blur());
  addEventListener("keydown", (event) => {
    if (event.target.tagName === "SELECT" || event.ctrlKey || event.metaKey || !KEYS[event.code]) return;
    if (event.code === "Space" && event.target.matches("button, [type=checkbox]")) return; // it presses them
    event.preventDefault();
    KEYS[event.code]();
  });
  if (data.shell) showShells(false);
  fold(innerWidth <= 700 || innerHeight < LOW);
  loop(true);
  play(true);
  const lit = data.lights.length > 0; // a show is seen at night, without trails
  if (lit) {
    addLamps();
    show("Trails", false);
  }
  theme(lit || matchMedia("(prefers-color-scheme: dark)").matches);
  look("free", 0);
  requestAnimationFrame(tick);
  window.drakeRho = {
    seek, play, loop, look, follow, colourBy, show, theme, fold, readings, tags, data,
    /** Draw the frame of a film at a time, without controls; the film plays at the given rate. */
    frame(time, rate) {
      if (!state.film) {
        state.film = true;
        state.speed = rate / data.rate;
        play(false);
        document.body.classList.add("film");
        document.body.classList.remove("folded");
        fitPanel();
        look(state.view, 0);
      }
      seek(time);
      viewer.render();
    },
  };
}

/** Start once Meshcat has all vehicles and the recording. */
(function wait() {
  const there = viewer.animator.actions.length > 0 && data.vehicles.every(({ path }) => node(["vehicles", path]));
  if (there) begin();
  else setTimeout(wait, 30);
})();
