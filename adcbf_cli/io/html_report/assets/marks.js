// Dots with intervals (planners, calibration), and gamma's map.

const ROW_PX = 20;

// rows: [{label, value, interval, colour, nominal}]; a scale from low to high. Words to the left, numbers to the right.
function dotPlot(title, unit, rows, low, high, room) {
  const { wide, left, right } = room, top = 8, high_px = top + rows.length * ROW_PX + 22;
  const x = (value) => left + ((value - low) / (high - low || 1)) * (wide - left - right);
  const picture = svg("svg", {
    viewBox: `0 0 ${wide} ${high_px}`, role: "img", class: "dots",
    "aria-label": `${title}: ${rows.map((row) => `${row.label} ${figure(row.value)}`).join(", ")}`,
  });
  for (const tick of [low, (low + high) / 2, high]) {
    picture.append(svg("line", { x1: x(tick), x2: x(tick), y1: top, y2: high_px - 20, class: "grid" }));
    picture.append(svg("text", { x: x(tick), y: high_px - 6, class: "tick", "text-anchor": "middle" }, figure(tick)));
  }
  rows.forEach((row, index) => {
    const y = top + (index + 0.5) * ROW_PX;
    picture.append(svg("text", { x: 0, y: y + 4, class: row.strong ? "strong" : "" }, row.label));
    if (row.nominal !== undefined && row.nominal !== null) {
      picture.append(svg("line", { x1: x(row.nominal), x2: x(row.nominal), y1: y - 8, y2: y + 8, class: "nominal" }));
    }
    if (row.value === null) {
      picture.append(svg("text", { x: wide - right + 12, y: y + 4, class: "tick" }, "–"));
      return;
    }
    const mark = svg("g", { class: row.colour });
    if (row.interval) {
      const [from, to] = row.interval.map((end) => Math.min(high, Math.max(low, end)));
      mark.append(svg("line", { x1: x(from), x2: x(to), y1: y, y2: y, class: "whisker" }));
    }
    mark.append(svg("circle", { cx: x(row.value), cy: y, r: 4 }));
    picture.append(mark);
    const range = row.interval && !room.brief ? ` (${row.interval.map(figure).join(" to ")})` : "";
    picture.append(svg("text", { x: wide - right + 12, y: y + 4, class: "tick" }, figure(row.value) + range));
  });
  return element("figure", { class: "dot-plot" }, element("figcaption", {}, unit ? `${title} [${unit}]` : title), picture);
}

const COMPARED = {
  replay: ["success", "collision", "min_dist_m", "nav_time_s", "jerk_rms_mps3", "solve_p95_ms"],
  plan: ["plan_error_1s_m", "plan_error_3s_m", "barrier_min_m2", "solve_p95_ms"],
};

// The planners' main metrics as dots, where there are planners to tell apart.
function plannerDots() {
  for (const holder of document.querySelectorAll("#planners .forest")) {
    const found = DATA.planners[holder.dataset.run][holder.dataset.kind];
    const names = Object.keys(found.planners);
    if (names.filter((name) => name !== LOGGED).length < 2) continue;
    for (const metric of COMPARED[holder.dataset.kind]) {
      const rows = names.map((name) => {
        const [value, interval] = found.planners[name][metric] || [null, null];
        const index = PLANNERS.indexOf(name);
        return { label: name, value, interval, colour: name === LOGGED ? "k-logged" : `k${index % COLOURS}` };
      }).filter((row) => row.value !== null);
      if (!rows.length) continue;
      const { unit, better } = found.metrics[metric];
      const ends = rows.flatMap((row) => [row.value, ...(row.interval || [])]);
      const rate = ["success", "collision"].includes(metric);
      const [low, high] = rate ? [0, 1] : roundedRange(ends);
      const way = better === "neither" ? "" : `, ${better} is better`;
      holder.append(dotPlot(`${metric}${way}`, unit, rows, low, high, { wide: 400, left: 108, right: 70, brief: true }));
    }
  }
}

function roundedRange(values) {
  const low = Math.min(...values), high = Math.max(...values), step = niceStep((high - low) / 4 || Math.abs(high) / 4 || 1);
  return [Math.floor(low / step - 0.2) * step, Math.ceil(high / step + 0.2) * step];
}

const REFERENCES = {
  prediction: "against ground truth",
  later_seen: "against where the same track was later seen",
  "later_seen.moving": "against later sightings, moving tracks only",
};

function calibrationDots() {
  for (const holder of runHolders("calibration")) {
    const run = DATA.runs[holder.dataset.run];
    for (const [reference, words] of Object.entries(REFERENCES)) {
      const points = run.calibration.filter((point) => point.reference === reference);
      if (!points.length) continue;
      const rows = [...points].sort((a, b) => group(a) - group(b) || (a.horizon_s ?? 99) - (b.horizon_s ?? 99))
        .map((point) => ({
          label: `${what(point)}, ${point.horizon_s === null ? "all steps" : `${point.horizon_s} s ahead`}`,
          value: point.observed, interval: point.interval, nominal: point.nominal ?? run.probability,
          colour: `k${group(point)}`, strong: point.horizon_s === null,
        }));
      const least = Math.min(...rows.flatMap((row) => [row.value, row.nominal, ...(row.interval || [])]));
      holder.querySelector(".calibration").append(dotPlot(`Share within, ${words}`, "", rows, Math.floor(least * 10) / 10, 1,
        { wide: 580, left: 204, right: 168 }));
    }
  }
  function group(point) {
    if (point.radius) return point.radius === "sigma_radius" ? 3 : 5;
    return [0.5, 0.9, 0.95].indexOf(point.nominal);
  }
  function what(point) {
    if (!point.radius) return `${figure(point.nominal * 100)} % ellipse`;
    return point.radius === "sigma_radius" ? "sigma radius" : "conformal radius";
  }
}

// Dark to light; lightness alone tells the values apart.
const RAMP = [[0, [38, 20, 74]], [0.25, [63, 71, 136]], [0.5, [49, 127, 141]], [0.75, [94, 190, 112]], [1, [250, 231, 85]]];

function ramp(value) {
  const at = Math.min(1, Math.max(0, value));
  const upper = RAMP.findIndex(([edge]) => at <= edge) || 1;
  const [[from, a], [to, b]] = [RAMP[upper - 1], RAMP[upper]];
  const share = (at - from) / (to - from);
  return `rgb(${a.map((part, k) => Math.round(part + (b[k] - part) * share)).join(",")})`;
}

function gammaMaps() {
  for (const holder of runHolders("map")) {
    const run = DATA.runs[holder.dataset.run];
    for (const map of run.gamma) holder.querySelector(".gamma-maps").append(gammaMap(map));
  }
}

function gammaMap(map) {
  const { distance_mm: distance, radius_mm: radius, gamma_e4: gamma } = map;
  const wide = 560, high = 300, left = 46, right = 70, bottom = 40, top = 8;
  const inner = { x: wide - left - right, y: high - top - bottom };
  const x = (mm) => left + ((mm - distance[0]) / (distance[distance.length - 1] - distance[0])) * inner.x;
  const y = (mm) => top + inner.y - ((mm - radius[0]) / (radius[radius.length - 1] - radius[0])) * inner.y;
  const picture = svg("svg", {
    viewBox: `0 0 ${wide} ${high}`, role: "img", class: "map",
    "aria-label": `gamma over distance and radius, for ${map.planners.join(", ")}`,
  });
  const dx = inner.x / (distance.length - 1), dy = inner.y / (radius.length - 1);
  const cells = svg("g", { "shape-rendering": "crispEdges" });
  distance.forEach((d, i) => radius.forEach((r, j) => {
    const value = gamma[i * radius.length + j] / 1e4;
    const from = Math.max(left, x(d) - dx / 2), to = Math.min(left + inner.x, x(d) + dx / 2);
    const low = Math.max(top, y(r) - dy / 2), up = Math.min(top + inner.y, y(r) + dy / 2);
    const cell = svg("rect", { x: from, y: low, width: to - from, height: up - low, fill: ramp(value) });
    cell.append(svg("title", {}, `d = ${d / 1000} m, r = ${r / 1000} m: gamma = ${figure(value)}`));
    cells.append(cell);
  }));
  picture.append(cells);
  for (const level of [0.1, 0.25, 0.5, 0.75, 0.95]) picture.append(...contour(map, level, x, y));
  picture.append(...touchingLine(map, x, y));
  for (const mm of ticksOf(distance)) {
    picture.append(svg("text", { x: x(mm), y: high - bottom + 16, class: "tick", "text-anchor": "middle" }, `${mm / 1000}`));
  }
  for (const mm of ticksOf(radius)) {
    picture.append(svg("text", { x: left - 6, y: y(mm) + 4, class: "tick", "text-anchor": "end" }, `${mm / 1000}`));
  }
  picture.append(svg("text", { x: left + inner.x / 2, y: high - 6, "text-anchor": "middle" }, "distance between centres [m]"));
  picture.append(svg("text", {
    x: 12, y: top + inner.y / 2, "text-anchor": "middle", transform: `rotate(-90 12 ${top + inner.y / 2})`,
  }, "radius [m]"));
  for (let k = 0; k < 50; k += 1) {
    picture.append(svg("rect", {
      x: wide - right + 14, y: top + inner.y * (1 - (k + 1) / 50), width: 14, height: inner.y / 50 + 0.5, fill: ramp((k + 0.5) / 50),
    }));
  }
  for (const value of [0, 0.5, 1]) {
    picture.append(svg("text", { x: wide - right + 33, y: top + inner.y * (1 - value) + (value === 1 ? 10 : 4), class: "tick" }, `${value}`));
  }
  return element("figure", { class: "gamma-map" }, element("figcaption", {}, `gamma of ${map.planners.join(", ")}`), picture);
}

// The line h = 0 and its label, as far as it lies within the map: a wide vehicle's may not at all.
function touchingLine(map, x, y) {
  const { distance_mm: distance, radius_mm: radius, keep_out_mm: apart } = map;
  const touching = radius.filter((r) => r + apart <= distance[distance.length - 1]);
  if (!touching.length) return [];
  const line = touching.map((r, k) => `${k ? "L" : "M"}${x(r + apart).toFixed(1)} ${y(r).toFixed(1)}`).join("");
  const end = touching[touching.length - 1];
  return [
    svg("path", { d: line, class: "touching" }),
    svg("text", { x: x(end + apart) + 6, y: y(end) + 14, class: "contour-label" }, "h = 0"),
  ];
}

function ticksOf(values) {
  const step = niceStep((values[values.length - 1] - values[0]) / 5000) * 1000, ticks = [];
  for (let mm = Math.ceil(values[0] / step) * step; mm <= values[values.length - 1]; mm += step) ticks.push(mm);
  return ticks;
}

// Marching squares: the pieces of the line where gamma is `level`, as one path, and its label.
function contour(map, level, x, y) {
  const { distance_mm: distance, radius_mm: radius, gamma_e4: gamma } = map, rows = radius.length;
  const at = (i, j) => gamma[i * rows + j] / 1e4 - level;
  const pieces = [];
  let path = "";
  for (let i = 0; i + 1 < distance.length; i += 1) {
    for (let j = 0; j + 1 < rows; j += 1) {
      const crossings = [];
      const edge = (i1, j1, i2, j2) => {
        const a = at(i1, j1), b = at(i2, j2);
        if ((a < 0) === (b < 0)) return;
        const share = a / (a - b);
        crossings.push([
          x(distance[i1] + share * (distance[i2] - distance[i1])), y(radius[j1] + share * (radius[j2] - radius[j1])),
        ]);
      };
      edge(i, j, i + 1, j);
      edge(i + 1, j, i + 1, j + 1);
      edge(i, j + 1, i + 1, j + 1);
      edge(i, j, i, j + 1);
      if (crossings.length < 2) continue;
      const [[x1, y1], [x2, y2]] = crossings;
      pieces.push([x1, y1]);
      path += `M${x1.toFixed(1)} ${y1.toFixed(1)}L${x2.toFixed(1)} ${y2.toFixed(1)}`;
    }
  }
  if (!path) return [];
  const [px, py] = pieces[Math.floor(pieces.length / 3)];
  return [svg("path", { d: path, class: "contour" }), svg("text", { x: px - 8, y: py + 4, class: "contour-label" }, `${level}`)];
}
