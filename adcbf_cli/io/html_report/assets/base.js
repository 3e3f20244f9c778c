// What all parts of the page share: the data, colours by theme, small DOM helpers, the time and what is chosen.

const DATA = JSON.parse(document.getElementById("data").textContent);
const LOGGED = "logged";
const KIND_NAMES = { replay: "closed loop", plan: "open loop" };
const DASHES = [[], [8, 4], [2, 3], [10, 3, 2, 3]];
const COLOURS = 7;

// A colour of the style sheet, looked up once a theme: canvases ask for it thousands of times a picture.
const cssCache = new Map();
function css(name) {
  if (!cssCache.has(name)) cssCache.set(name, getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  return cssCache.get(name);
}

function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  fill(made, attributes, children);
  return made;
}

function svg(tag, attributes = {}, ...children) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  fill(made, attributes, children);
  return made;
}

function fill(made, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== null && value !== undefined) made.setAttribute(name, value);
  }
  made.append(...children);
}

// Four significant digits, a dash for what is not known.
function figure(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  return Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(4)));
}

function scaled(values, by) {
  return values.map((value) => (value === null ? null : value / by));
}

// The index of the last of `times` (ascending) that is not after `at`, or -1.
function lastUpTo(times, at) {
  let low = 0, high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= at) low = middle + 1; else high = middle;
  }
  return low - 1;
}

// Planners keep their colour and dash over the whole page; beyond the colours, dashes tell them apart.
const PLANNERS = (() => {
  const names = new Set();
  for (const run of DATA.runs) for (const group of run.drives) for (const name of group.planners) names.add(name);
  return [...names].sort((a, b) => (a === LOGGED) - (b === LOGGED));
})();

function planColour(name) {
  return name === LOGGED ? css("--muted") : css(`--c${PLANNERS.indexOf(name) % COLOURS}`);
}

function planDash(name) {
  return name === LOGGED ? [4, 4] : DASHES[Math.floor(PLANNERS.indexOf(name) / COLOURS) % DASHES.length];
}

// What the reader looks at. `listeners` are told of every change by name: "time", "choice" or "theme".
const view = {
  t_ms: 0,
  end_ms: 0,
  kind: null,
  seed: null,
  planners: new Set(),
  layers: {},
  track: DATA.runs.map(() => null),
  listeners: { time: [], choice: [], theme: [] },
  // Returns what ends it.
  on(what, tell) {
    this.listeners[what].push(tell);
    return () => { this.listeners[what] = this.listeners[what].filter((each) => each !== tell); };
  },
  changed(what) { for (const tell of this.listeners[what]) tell(); },
};

// The drives of a run that are chosen, by kind, seed and planner.
function chosenDrives(run) {
  const group = run.drives.find((each) => each.kind === view.kind);
  if (!group) return [];
  const logged = group.drives.filter((drive) => drive.planner === LOGGED);
  const mine = group.drives.filter((drive) => drive.planner !== LOGGED && drive.seed === view.seed);
  return [...mine, ...logged].filter((drive) => view.planners.has(drive.planner));
}

function chosenGroup(run) {
  return run.drives.find((group) => group.kind === view.kind) || null;
}

view.on("theme", () => cssCache.clear());

for (const run of DATA.runs) {
  const shown = run.scene.shown;
  run.frameTimes = shown.map((frame) => frame.t_ms);
  view.end_ms = Math.max(view.end_ms, ...run.scene.counts.t_ms.slice(-1));
  for (const group of run.drives) {
    for (const drive of group.drives) view.end_ms = Math.max(view.end_ms, ...drive.t_ms.slice(-1));
  }
}
