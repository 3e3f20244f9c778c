// Tracks over time: a bar for each one's life, and one chosen track's position with what was predicted of it.

const STATES = ["tentative", "moving", "standing", "coasting"];
const BAR_PX = 12;

function livesCharts() {
  for (const holder of runHolders("tracks")) {
    const number = Number(holder.dataset.run), run = DATA.runs[number], lives = run.scene.lives;
    const place = holder.querySelector(".lives");
    if (!lives.length) continue;
    place.append(element("h4", {}, `Lives of ${lives.length} confirmed tracks: click one to follow it`));
    place.append(keys(STATES, "life"), livesPicture(lives, number));
    const follow = followControl(lives, number);
    holder.querySelector(".one-track").before(follow);
    followTrack(holder.querySelector(".one-track"), run, number);
  }
}

function keys(names, kind) {
  const items = names.map((name) => {
    const box = svg("svg", { width: 14, height: 10, "aria-hidden": "true" });
    box.append(svg("rect", { width: 14, height: 10, class: `${kind} ${name}` }));
    return element("li", {}, box, ` ${name}`);
  });
  return element("ul", { class: "keys" }, ...items);
}

function livesPicture(lives, number) {
  const rows = lives.map(({ id, spans }) => ({
    name: String(id),
    title: `track ${id}: ${lifeInWords(spans)}`,
    spans: spans.map(([from, to, state]) => [from, to, `life ${STATES[state]}`]),
    click: () => {
      view.track[number] = id;
      view.changed("choice");
    },
    selected: () => view.track[number] === id,
  }));
  return barsPicture(rows, `${lives.length} tracks over time, each a bar coloured by its state`, BAR_PX, CHART_LEFT).frame;
}

// rows: [{name, title, spans: [[from, to in ms, class]], click, selected}]: bars under the charts' time axis, and what to
// call when they go from the page.
function barsPicture(rows, words, row_px, left) {
  const end = Math.max(1, view.end_ms), high = rows.length * row_px;
  const picture = svg("svg", {
    class: "bars", viewBox: `0 0 1000 ${high}`, preserveAspectRatio: "none", height: high, role: "img", "aria-label": words,
  });
  const names = svg("svg", { class: "bar-names", width: left, height: high, "aria-hidden": "true" });
  rows.forEach(({ name, title, spans, click }, row) => {
    const group = svg("g", {});
    group.append(svg("title", {}, title), svg("rect", { x: 0, y: row * row_px, width: 1000, height: row_px, class: "hit" }));
    for (const [from, to, look] of spans) {
      group.append(svg("rect", {
        x: (from / end) * 1000, width: Math.max(1, ((to - from) / end) * 1000), y: row * row_px + 1, height: row_px - 2,
        class: look,
      }));
    }
    if (click) group.addEventListener("click", click);
    picture.append(group);
    names.append(svg("text", { x: left - 6, y: (row + 1) * row_px - 2.5, "text-anchor": "end" }, name));
  });
  const now = svg("line", { y1: 0, y2: high, class: "now-line" });
  picture.append(now);
  const mark = () => {
    now.setAttribute("x1", (view.t_ms / end) * 1000);
    now.setAttribute("x2", (view.t_ms / end) * 1000);
  };
  const select = () => rows.forEach(({ selected }, row) => {
    picture.querySelectorAll("g")[row].classList.toggle("selected", Boolean(selected && selected()));
  });
  const ends = [view.on("time", mark), view.on("choice", select)];
  mark();
  const frame = element("div", { class: "bars-frame" }, names, picture);
  return { frame, forget: () => { for (const end of ends) end(); } };
}

const OUTCOMES = ["relaxed", "braked", "stopped"];

// When planners left the plain solution: one row a planner of the chosen drives that has steps.
function fallbackBars() {
  for (const holder of runHolders("margins")) {
    const run = DATA.runs[holder.dataset.run], place = holder.querySelector(".fallbacks");
    let forget = () => {};
    const show = () => {
      forget();
      forget = () => {};
      place.replaceChildren();
      const drives = chosenDrives(run).filter((drive) => drive.planner !== LOGGED);
      if (!drives.length) return;
      const rows = drives.map(({ planner, fallbacks }) => ({
        name: planner,
        title: `${planner}: ${fallbacks.length ? fallbackWords(fallbacks) : "no fallback"}`,
        spans: fallbacks.map(([from, to, outcome]) => [from, to, `fallback ${outcome}`]),
      }));
      const steps = drives.reduce((sum, drive) => sum + drive.fallbacks.length, 0);
      place.append(element("h4", {}, "Fallbacks: where a step was not simply solved"));
      if (!steps) {
        place.append(element("p", { class: "hint" }, "None in the chosen drives."));
        return;
      }
      place.append(keys(OUTCOMES, "fallback"));
      const bars = barsPicture(rows, `fallbacks of ${rows.map((row) => row.title).join("; ")}`, 16, 92);
      forget = bars.forget;
      place.append(bars.frame);
    };
    view.on("choice", show);
    show();
  }
}

function fallbackWords(fallbacks) {
  const shown = fallbacks.slice(0, 12).map(([from, to, outcome]) =>
    `${outcome} ${(from / 1000).toFixed(2)} to ${(to / 1000).toFixed(2)} s`);
  return shown.join(", ") + (fallbacks.length > 12 ? `, and ${fallbacks.length - 12} more` : "");
}

function lifeInWords(spans) {
  return spans.map(([from, to, state]) =>
    `${STATES[state]} ${(from / 1000).toFixed(1)} to ${(to / 1000).toFixed(1)} s`).join(", ");
}

function followControl(lives, number) {
  const select = element("select", {});
  for (const { id, spans } of lives) select.append(element("option", { value: id }, `${id} (${lifeLength(spans)} s)`));
  select.addEventListener("change", () => {
    view.track[number] = Number(select.value);
    view.changed("choice");
  });
  view.on("choice", () => { select.value = String(view.track[number]); });
  return element("label", { class: "follow" }, "Track to follow: ", select);
}

function lifeLength(spans) {
  return ((spans[spans.length - 1][1] - spans[0][0]) / 1000).toFixed(1);
}

// The track that moved longest, else the one that lived longest.
function firstToFollow(lives) {
  const moved = ({ spans }) => spans.reduce((sum, [from, to, state]) => sum + (state === 1 ? to - from : 0), 0);
  const lived = ({ spans }) => spans[spans.length - 1][1] - spans[0][0];
  return [...lives].sort((a, b) => moved(b) - moved(a) || lived(b) - lived(a) || a.id - b.id)[0].id;
}

function followTrack(place, run, number) {
  const charts = ["x", "y"].map((axis) => {
    const holder = element("div", { class: "chart" });
    place.append(holder);
    return [axis, new TimeChart(holder, { title: `Position along ${axis} of the followed track`, unit: "m" })];
  });
  let shown = null;
  const show = () => {
    if (view.track[number] === shown) return;
    shown = view.track[number];
    for (const [axis, chart] of charts) chart.show(trackSeries(run, shown, axis));
  };
  view.on("choice", show);
  view.track[number] = firstToFollow(run.scene.lives);
  show();
}

// The estimate with its interval of two sigmas, and where it was predicted to be, drawn at the predicted time.
function trackSeries(run, id, axis) {
  const place = axis === "x" ? 2 : 3, spread = axis === "x" ? 6 : 8, origin = run.scene.origin_m[axis === "x" ? 0 : 1];
  const t_ms = [], values = [], low = [], high = [];
  for (const frame of run.scene.shown) {
    const track = (frame.tracks || []).find((each) => each[0] === id);
    t_ms.push(frame.t_ms);
    const known = Boolean(track), two = known ? 2 * Math.sqrt(track[spread]) : 0;
    values.push(known ? track[place] / 1000 + origin : null);
    low.push(known ? (track[place] - two) / 1000 + origin : null);
    high.push(known ? (track[place] + two) / 1000 + origin : null);
  }
  const faint = { colour: () => css("--muted"), width: 0.8, dash: [2, 2] };
  return [
    { label: "estimate", t_ms, values, colour: () => css("--moving"), width: 2 },
    { label: "estimate - 2 sigma", t_ms, values: low, ...faint },
    { label: "estimate + 2 sigma", t_ms, values: high, ...faint, bandFrom: true },
    ...[Math.ceil(run.scene.steps.length / 3) - 1, run.scene.steps.length - 1].filter((k, at, all) => k >= 0 && all.indexOf(k) === at)
      .map((step, at) => predictedSeries(run, id, axis, step, origin, at)),
  ];
}

function predictedSeries(run, id, axis, step, origin, at) {
  const ahead = run.scene.steps[step] * run.scene.step_ms, last = step === run.scene.steps.length - 1;
  const t_ms = [], values = [];
  for (const frame of run.scene.shown) {
    const row = (frame.predictions || []).find((each) => each[0] === id);
    const all = row && row.length > 6;
    const first = all ? 1 + 5 * step : 1;
    t_ms.push(frame.t_ms + ahead);
    values.push(row && (all || last) ? row[first + (axis === "x" ? 0 : 1)] / 1000 + origin : null);
  }
  return {
    label: `predicted ${figure(ahead / 1000)} s before`, t_ms, values, width: 1.4, dash: at ? [3, 3] : [8, 3],
    colour: () => css(at ? "--predicted" : "--c3"),
  };
}
