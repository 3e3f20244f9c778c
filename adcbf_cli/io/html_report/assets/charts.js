// Lines over time, with uPlot. Every chart marks the page's time, and a click on one sets it.

const CHARTS = [];
const CHART_HEIGHT = 200;
const CHART_LEFT = 52;
const CHART_RIGHT = 14;

// series: [{label, t_ms, values, colour: () => text, dash, width, dots: bool, bandFrom: bool}] (bandFrom: the space
// between the series before and this one is tinted); options: {title, unit, log, marks: () => [{value, label}],
// include: values that the scale must hold}.
class TimeChart {
  constructor(holder, options) {
    this.holder = holder;
    this.options = options;
    this.plot = null;
    CHARTS.push(this);
    new ResizeObserver(() => this.resize()).observe(holder);
  }

  show(series) {
    if (this.plot) this.plot.destroy();
    this.plot = null;
    this.holder.replaceChildren();
    const known = series.filter((each) => each.values.some((value) => value !== null));
    const { title, unit, log, empty } = this.options;
    this.holder.hidden = !known.length && !(series.length && empty);
    if (this.holder.hidden) return;
    this.holder.append(element("h4", {}, unit ? `${title} [${unit}]` : title));
    if (!known.length) {
      this.holder.append(element("p", { class: "hint" }, empty));
      return;
    }
    const tables = known.map((each) => [scaled(each.t_ms, 1000), each.values]);
    const data = uPlot.join(tables, tables.map(() => [0, 1]));
    this.plot = new uPlot({
      width: this.width(),
      height: CHART_HEIGHT,
      legend: { live: true },
      padding: [8, CHART_RIGHT, 0, 0],
      bands: known.flatMap((each, at) => (each.bandFrom ? [{ series: [at + 1, at], fill: () => this.tint(each) }] : [])),
      cursor: { drag: { x: true, y: false }, sync: { key: "time" }, points: { size: 6 } },
      scales: { x: { time: false, range: (plot, low, high) => this.within(low, high) }, y: this.scale(log) },
      axes: [this.axis("s", 28), this.axis("", CHART_LEFT)],
      series: [
        { label: "t", value: (plot, value) => (value === null ? "–" : `${value.toFixed(2)} s`) },
        ...known.map((each) => this.line(each)),
      ],
      hooks: { draw: [(plot) => this.marks(plot)], ready: [(plot) => this.ready(plot)] },
    }, data, this.holder);
    this.holder.setAttribute("role", "group");
    this.holder.setAttribute("aria-label", this.inWords(known));
  }

  inWords(series) {
    const ranges = series.map((each) => {
      const values = each.values.filter((value) => value !== null);
      const low = values.reduce((a, b) => Math.min(a, b), Infinity);
      const high = values.reduce((a, b) => Math.max(a, b), -Infinity);
      return `${each.label} from ${figure(low)} to ${figure(high)}`;
    });
    return `${this.options.title} over time, in ${this.options.unit || "numbers"}: ${ranges.join("; ")}`;
  }

  // Zoomed in, uPlot's own range; else the whole page's time, so that charts stand above one another.
  within(low, high) {
    const end = view.end_ms / 1000;
    return low === null || (low <= 0 && high >= end) || !this.zoomed ? [0, Math.max(end, 0.1)] : [low, high];
  }

  scale(log) {
    if (log) {
      const most = (high) => Math.max(high || 1, ...(this.options.marks ? this.options.marks() : []).map(({ value }) => value));
      return { distr: 3, range: (plot, low, high) => [(low || 0.01) * 0.8, most(high) * 1.5] };
    }
    const must = this.options.include || [];
    return {
      range: (plot, low, high) => {
        const bottom = Math.min(low ?? 0, ...must), top = Math.max(high ?? 1, ...must), room = (top - bottom) * 0.06;
        return [bottom - room, top + (room || 1)];
      },
    };
  }

  axis(unit, size) {
    return {
      stroke: () => css("--muted"),
      grid: { stroke: () => css("--line"), width: 1 },
      ticks: { stroke: () => css("--line"), width: 1 },
      font: "11px system-ui, sans-serif",
      size,
      values: (plot, values, axis) => values.map((value) => (
        value === null || (axis === 1 && this.options.log && !isPowerOfTen(value)) ? "" : `${figure(value)}${unit && ` ${unit}`}`)),
    };
  }

  line(each) {
    return {
      label: each.label,
      stroke: () => each.colour(),
      width: each.width ?? 1.6,
      dash: each.dash,
      spanGaps: false,
      paths: each.dots ? () => null : undefined,
      points: each.dots ? { show: true, size: 3.5, width: 0, fill: () => each.colour() } : { show: false },
      value: (plot, value) => figure(value),
    };
  }

  tint(each) { return `color-mix(in srgb, ${each.colour()} 18%, transparent)`; }

  marks(plot) {
    const pen = plot.ctx, { left, width, top, height } = plot.bbox, ratio = window.devicePixelRatio || 1;
    pen.save();
    for (const { value, label } of this.options.marks ? this.options.marks() : []) {
      const y = plot.valToPos(value, "y", true);
      if (y < top || y > top + height) continue;
      pen.strokeStyle = pen.fillStyle = css("--fg");
      pen.setLineDash([4 * ratio, 4 * ratio]);
      pen.lineWidth = ratio;
      pen.beginPath();
      pen.moveTo(left, y);
      pen.lineTo(left + width, y);
      pen.stroke();
      pen.font = `${11 * ratio}px system-ui, sans-serif`;
      pen.textAlign = "right";
      pen.fillText(label, left + width - 3 * ratio, y - 3 * ratio);
    }
    pen.restore();
  }

  ready(plot) {
    this.now = element("div", { class: "now", "aria-hidden": "true" });
    plot.over.append(this.now);
    let from = 0;
    plot.over.addEventListener("mousedown", (event) => { from = event.clientX; });
    plot.over.addEventListener("mouseup", (event) => {
      this.zoomed = Math.abs(event.clientX - from) > 3 || this.zoomed;
      if (Math.abs(event.clientX - from) <= 3) setTime(plot.posToVal(plot.cursor.left, "x") * 1000);
    });
    plot.over.addEventListener("dblclick", () => { this.zoomed = false; });
    plot.over.addEventListener("mouseleave", () => this.mark());
    this.plot = plot;
    this.mark();
  }

  mark() {
    if (!this.plot || !this.now) return;
    const left = this.plot.valToPos(view.t_ms / 1000, "x");
    if (!this.plot.over.matches(":hover")) this.plot.setLegend({ idx: this.plot.valToIdx(view.t_ms / 1000) });
    this.now.style.display = left >= 0 && left <= this.plot.over.clientWidth ? "block" : "none";
    this.now.style.transform = `translateX(${left.toFixed(1)}px)`;
  }

  width() { return Math.max(240, Math.floor(this.holder.clientWidth || this.holder.parentElement.clientWidth)); }

  resize() {
    if (this.plot && this.plot.width !== this.width()) {
      this.plot.setSize({ width: this.width(), height: CHART_HEIGHT });
      this.mark();
    }
  }
}

function isPowerOfTen(value) { return Math.abs(Math.log10(value) - Math.round(Math.log10(value))) < 1e-9; }

view.on("time", () => { for (const chart of CHARTS) chart.mark(); });
view.on("theme", () => { for (const chart of CHARTS) if (chart.plot) chart.plot.redraw(); });

function runHolders(section) {
  return [...document.querySelectorAll(`#${section} [data-run]`)];
}

// One line a planner of the chosen drives.
function byPlanner(drives, name, scale, extra = {}) {
  return drives.filter((drive) => drive[name]).map((drive) => ({
    label: drive.planner,
    t_ms: drive.t_ms,
    values: scaled(drive[name], scale),
    colour: () => planColour(drive.planner),
    dash: planDash(drive.planner),
    ...extra,
  }));
}

function countCharts() {
  for (const holder of runHolders("tracks")) {
    const { counts } = DATA.runs[holder.dataset.run].scene;
    const kinds = [
      ["clusters", "clusters", "--muted", [2, 3]], ["moving", "moving tracks", "--moving", []],
      ["standing", "standing tracks", "--standing", [8, 3]], ["coasting", "coasting tracks", "--c4", [4, 3]],
    ];
    const series = kinds.filter(([name]) => counts[name]).map(([name, label, colour, dash]) => (
      { label, t_ms: counts.t_ms, values: counts[name], colour: () => css(colour), dash }));
    new TimeChart(holder.querySelector(".counts"), { title: "What was seen and followed", unit: "a scan", include: [0] })
      .show(series);
  }
}

const UNSTAGED = "Not stored for these drives: plans are kept stage by stage for each planner's first seed, and only "
  + "planners with a barrier have one.";

function driveCharts() {
  for (const holder of runHolders("margins")) {
    const run = DATA.runs[holder.dataset.run];
    const limits = () => [{ value: 0, label: "contact" }];
    const clearance = new TimeChart(holder.querySelector(".clearance"),
      { title: "Clearance to the nearest true obstacle", unit: "m", include: [0], marks: limits });
    const barrier = new TimeChart(holder.querySelector(".barrier"),
      { title: "Smallest barrier h over the known obstacles: now, and in the plan (dotted)", unit: "m²", include: [0],
        marks: () => [{ value: 0, label: "h = 0" }], empty: UNSTAGED });
    const gamma = new TimeChart(holder.querySelector(".gamma"),
      { title: "Gamma of the obstacle with the smallest barrier, now", unit: "", include: [0, 1], empty: UNSTAGED });
    const show = () => {
      const drives = chosenDrives(run);
      clearance.show(byPlanner(drives, "clearance_mm", 1000));
      const smallest = byPlanner(drives, "barrier_min_cm2", 1e4, { dash: [1, 3], width: 1.2 });
      for (const each of smallest) each.label += ", smallest in the plan";
      barrier.show([...byPlanner(drives, "barrier_cm2", 1e4), ...smallest]);
      gamma.show(byPlanner(drives, "gamma_e4", 1e4));
    };
    view.on("choice", show);
    show();
  }
}

function solveCharts() {
  for (const holder of runHolders("times")) {
    const run = DATA.runs[holder.dataset.run];
    const deadline = () => {
      const group = chosenGroup(run);
      return group ? [{ value: group.deadline_ms, label: `deadline ${figure(group.deadline_ms)} ms` }] : [];
    };
    const chart = new TimeChart(holder.querySelector(".solve"),
      { title: "Time of each planning step", unit: "ms", log: true, marks: deadline });
    const show = () => chart.show(byPlanner(chosenDrives(run), "solve_us", 1000, { dots: true }));
    view.on("choice", show);
    show();
  }
}
