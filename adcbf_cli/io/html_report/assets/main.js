// Controls, the player, and the order in which the page is put together.

function setTime(t_ms) {
  view.t_ms = Math.min(view.end_ms, Math.max(0, t_ms));
  const slider = document.getElementById("time");
  slider.value = String(Math.round(view.t_ms));
  slider.setAttribute("aria-valuetext", `${(view.t_ms / 1000).toFixed(1)} seconds`);
  document.getElementById("clock").textContent = `${(view.t_ms / 1000).toFixed(1)} / ${(view.end_ms / 1000).toFixed(1)} s`;
  view.changed("time");
}

function player() {
  const slider = document.getElementById("time"), button = document.getElementById("play");
  const rate = document.getElementById("rate");
  let playing = false, before = 0;
  slider.max = String(Math.round(view.end_ms));
  slider.step = String(Math.max(1, Math.round(view.end_ms / 2000)));
  const show = () => {
    button.textContent = playing ? "Pause" : "Play";
    button.setAttribute("aria-label", playing ? "Pause" : "Play");
  };
  const tick = (now) => {
    if (!playing) return;
    setTime(view.t_ms + (now - before) * Number(rate.value));
    before = now;
    if (view.t_ms >= view.end_ms) playing = false;
    show();
    if (playing) requestAnimationFrame(tick);
  };
  button.addEventListener("click", () => {
    playing = !playing;
    if (playing && view.t_ms >= view.end_ms) setTime(0);
    before = performance.now();
    show();
    if (playing) requestAnimationFrame(tick);
  });
  slider.addEventListener("input", () => setTime(Number(slider.value)));
  slider.addEventListener("keydown", (event) => {
    const steps = { PageUp: 5000, PageDown: -5000, ArrowRight: 100, ArrowUp: 100, ArrowLeft: -100, ArrowDown: -100 };
    if (steps[event.key] === undefined) return;
    event.preventDefault();
    setTime(view.t_ms + steps[event.key]);
  });
}

function checkbox(label, checked, change, swatch) {
  const box = element("input", { type: "checkbox" });
  box.checked = checked;
  box.addEventListener("change", () => change(box.checked));
  return element("label", {}, box, ...(swatch ? [swatch] : []), ` ${label}`);
}

function layerControls() {
  const field = document.getElementById("layers");
  for (const [name, label] of LAYERS) {
    view.layers[name] = true;
    field.append(checkbox(label, true, (on) => {
      view.layers[name] = on;
      view.changed("time");
    }));
  }
}

function swatch(planner) {
  const box = svg("svg", { width: 18, height: 8, "aria-hidden": "true" });
  const line = svg("line", { x1: 0, x2: 18, y1: 4, y2: 4, "stroke-width": 3, class: planner === LOGGED ? "k-logged" : `k${PLANNERS.indexOf(planner) % COLOURS}` });
  line.setAttribute("stroke-dasharray", planDash(planner).join(" "));
  box.append(line);
  return box;
}

function driveControls() {
  const holder = document.getElementById("drive-controls");
  const groups = DATA.runs.flatMap((run) => run.drives);
  if (!groups.length) return;
  const kinds = ["replay", "plan"].filter((kind) => groups.some((group) => group.kind === kind));
  view.kind = kinds[0];
  view.planners = new Set(PLANNERS);
  const kind = element("select", { id: "kind" });
  for (const each of kinds) kind.append(element("option", { value: each }, KIND_NAMES[each]));
  const seed = element("select", { id: "seed" });
  const offer = () => {
    const seeds = [...new Set(groups.filter((group) => group.kind === view.kind).flatMap((group) => group.shown_seeds))];
    view.seed = seeds[0]; // the one whose plans are stored
    seeds.sort((a, b) => a - b);
    seed.replaceChildren(...seeds.map((each) => element("option", { value: each }, String(each))));
    if (seeds.length) seed.value = String(view.seed);
  };
  kind.addEventListener("change", () => {
    view.kind = kind.value;
    offer();
    view.changed("choice");
  });
  seed.addEventListener("change", () => {
    view.seed = Number(seed.value);
    view.changed("choice");
  });
  offer();
  const boxes = PLANNERS.map((name) => checkbox(name, true, (on) => {
    if (on) view.planners.add(name); else view.planners.delete(name);
    view.changed("choice");
  }, swatch(name)));
  holder.append(element("label", {}, "drives: ", kind), element("label", {}, "seed: ", seed), ...boxes);
}

function legend() {
  const share = [...new Set(DATA.runs.map((run) => `${figure(run.probability * 100)} %`))].join(" or ");
  const words = [
    "Dots: points, coloured by cluster, grey where they belong to none.",
    "Thin grey rectangle: a cluster.",
    "Circle: a track. Thick and orange while it moves, with an arrow of 1 s of its velocity; thin and blue while it stands; "
      + "dashed while it is not seen; dotted while it is tentative.",
    `Filled ellipse within it: where it is, with a probability of ${share}. Outlined ellipses: where it will be, with the same `
      + "probability, half-way and at the end of the prediction; the line leads to them.",
    "Dashed line to a ring: the reference path and its goal.",
    "Thick line, ring and arrowhead: what a planner has driven, and where it is; thin line with dots: its plan. A cross: its "
      + "drive ended in a collision or a timeout.",
    "Grey line and arrowhead: the log's own vehicle.",
  ];
  document.getElementById("legend").append(...words.map((text) => element("li", {}, text)));
}

// The page opens at the smallest clearance of the chosen drives, else a quarter into the log.
function firstSight() {
  let nearest = Infinity, at = view.end_ms / 4;
  for (const drive of DATA.runs.flatMap(chosenDrives).filter((each) => each.planner !== LOGGED)) {
    drive.clearance_mm.forEach((value, k) => {
      if (value !== null && value < nearest) { nearest = value; at = drive.t_ms[k]; }
    });
  }
  return at;
}

function start() {
  layerControls();
  driveControls();
  legend();
  const scenes = [...document.querySelectorAll(".scene")].map((holder) => (
    new Scene(holder, DATA.runs[holder.dataset.run], Number(holder.dataset.run))));
  const draw = () => { for (const scene of scenes) scene.draw(); };
  view.on("time", draw);
  view.on("choice", draw);
  view.on("theme", draw);
  countCharts();
  livesCharts();
  driveCharts();
  fallbackBars();
  plannerDots();
  solveCharts();
  gammaMaps();
  calibrationDots();
  player();
  view.changed("choice");
  setTime(firstSight());
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => view.changed("theme"));
}

start();
