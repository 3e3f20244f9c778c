// The top view: one canvas a run, all at the same time.

const LAYERS = [
  ["points", "points"], ["clusters", "clusters"], ["tracks", "tracks"], ["ellipses", "ellipses"],
  ["predictions", "predictions"], ["reference", "reference"], ["plans", "plans"], ["paths", "driven paths"],
  ["labels", "labels"],
];

class Scene extends Picture {
  constructor(holder, run, number) {
    super();
    this.run = run;
    this.number = number;
    this.canvas = holder.querySelector("canvas");
    this.readout = holder.querySelector(".readout");
    this.pen = this.canvas.getContext("2d", { alpha: false });
    this.sigmas = Math.sqrt(-2 * Math.log(1 - run.probability));
    this.origin = run.scene.origin_m;
    this.extent = this.bounds();
    this.view = null;
    this.listen();
    this.resize();
    new ResizeObserver(() => this.resize()).observe(this.canvas);
  }

  // What must be in sight when fitted: the vehicle's ways, and the obstacles within the perceived range.
  bounds() {
    const xs = [], ys = [];
    const add = (x, y) => { xs.push(x / 1000); ys.push(y / 1000); };
    for (const frame of this.run.scene.shown) {
      if (frame.sensor) add(frame.sensor[0], frame.sensor[1]);
      for (const track of frame.tracks || []) add(track[2], track[3]);
      if (!frame.tracks) for (let k = 0; k < frame.clusters.length; k += 6) add(frame.clusters[k], frame.clusters[k + 1]);
    }
    for (const group of this.run.drives) {
      for (const drive of group.drives) {
        for (let k = 0; k < drive.x_mm.length; k += 10) add(drive.x_mm[k], drive.y_mm[k]);
      }
    }
    const low = (values) => values.reduce((a, b) => Math.min(a, b), Infinity);
    const high = (values) => values.reduce((a, b) => Math.max(a, b), -Infinity);
    if (!xs.length) return { left: -5, right: 5, bottom: -5, top: 5 };
    return { left: low(xs) - 1, right: high(xs) + 1, bottom: low(ys) - 1, top: high(ys) + 1 };
  }

  resize() {
    const box = this.canvas.getBoundingClientRect();
    if (!box.width) return;
    const ratio = window.devicePixelRatio || 1;
    const wide = Math.round(box.width * ratio), high = Math.round(box.height * ratio);
    if (this.canvas.width !== wide || this.canvas.height !== high) {
      this.canvas.width = wide;
      this.canvas.height = high;
    }
    this.width = box.width;
    this.height = box.height;
    this.ratio = ratio;
    if (!this.view || !this.view.moved) this.fit();
    this.draw();
  }

  fit() {
    const { left, right, bottom, top } = this.extent;
    const scale = Math.min(this.width / (right - left), (this.height - FOOT_PX) / (top - bottom));
    this.view = { scale, x: (left + right) / 2, y: (bottom + top) / 2, moved: false };
  }

  listen() {
    const canvas = this.canvas;
    let held = null;
    canvas.addEventListener("pointerdown", (event) => {
      held = { x: event.clientX, y: event.clientY, far: 0 };
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!held) return;
      const dx = event.clientX - held.x, dy = event.clientY - held.y;
      held = { x: event.clientX, y: event.clientY, far: held.far + Math.hypot(dx, dy) };
      this.move(dx, dy);
    });
    canvas.addEventListener("pointerup", (event) => {
      if (held && held.far < 4) this.choose(event);
      held = null;
    });
    canvas.addEventListener("pointercancel", () => { held = null; });
    canvas.addEventListener("dblclick", () => this.refit());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const box = canvas.getBoundingClientRect();
      this.zoom(Math.exp(-event.deltaY / 400), event.clientX - box.left, event.clientY - box.top);
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  key(event) {
    const step = 40;
    const moves = { ArrowLeft: [step, 0], ArrowRight: [-step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
    if (moves[event.key]) this.move(...moves[event.key]);
    else if (event.key === "+" || event.key === "=") this.zoom(1.25, this.width / 2, this.height / 2);
    else if (event.key === "-") this.zoom(0.8, this.width / 2, this.height / 2);
    else if (event.key === "0") this.refit();
    else return;
    event.preventDefault();
  }

  refit() {
    this.fit();
    this.draw();
  }

  move(dx, dy) {
    this.view.x -= dx / this.view.scale;
    this.view.y += dy / this.view.scale;
    this.view.moved = true;
    this.draw();
  }

  zoom(by, px, py) {
    const x = this.view.x + (px - this.width / 2) / this.view.scale;
    const y = this.view.y - (py - (this.height - FOOT_PX) / 2) / this.view.scale;
    const scale = Math.min(2000, Math.max(0.5, this.view.scale * by));
    this.view.x = x - (px - this.width / 2) / scale;
    this.view.y = y + (py - (this.height - FOOT_PX) / 2) / scale;
    this.view.scale = scale;
    this.view.moved = true;
    this.draw();
  }

  // The track nearest to a click, within a finger's breadth.
  choose(event) {
    const frame = this.frame();
    const box = this.canvas.getBoundingClientRect();
    let best = null, nearest = 24;
    for (const track of (frame && frame.tracks) || []) {
      const [x, y] = this.mm(track[2], track[3]);
      const off = Math.hypot(x - (event.clientX - box.left), y - (event.clientY - box.top));
      if (off < Math.max(nearest, best === null ? this.px(track[9]) : 0)) { best = track[0]; nearest = off; }
    }
    if (best !== null) {
      view.track[this.number] = best;
      view.changed("choice");
    }
  }

  frame() {
    const index = lastUpTo(this.run.frameTimes, view.t_ms);
    return index < 0 ? null : this.run.scene.shown[index];
  }

  draw() {
    if (!this.view) return;
    const pen = this.pen, on = view.layers, frame = this.frame();
    pen.save();
    pen.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    pen.fillStyle = css("--panel");
    pen.fillRect(0, 0, this.width + 1, this.height + 1);  // the last column may be covered in part only
    this.grid();
    const over = this.run.scene.counts.t_ms.slice(-1)[0] ?? 0;
    if (frame) {
      pen.globalAlpha = view.t_ms > over + 1000 ? 0.35 : 1;
      if (on.points) this.points(frame);
      if (on.clusters) this.clusters(frame);
      if (on.predictions) this.predictions(frame);
      if (on.tracks) this.tracks(frame);
      pen.globalAlpha = 1;
    }
    const group = chosenGroup(this.run);
    if (on.reference && group) this.reference(group.route);
    this.logPath(frame);
    const drives = chosenDrives(this.run).filter((drive) => drive.planner !== LOGGED);
    for (const drive of drives) this.drive(drive, group, drives.length);
    this.foot();
    pen.restore();
    this.tell(frame, drives, over);
  }

  // The same in words.
  tell(frame, drives, over_ms) {
    const parts = [`t = ${(view.t_ms / 1000).toFixed(1)} s`];
    if (view.t_ms > over_ms + 1000) parts.push("after the recording's end");
    else if (frame) {
      parts.push(`scan ${frame.frame}`, `${frame.clusters.length / 6} clusters`);
      if (frame.tracks) {
        const moving = frame.tracks.filter((track) => track[1] === 1).length;
        parts.push(`${frame.tracks.length} tracks, ${moving} moving`);
      }
    }
    for (const drive of drives) {
      const at = lastUpTo(drive.t_ms, view.t_ms);
      const over = at === drive.t_ms.length - 1 && drive.result;
      if (over) parts.push(`${drive.planner}: ${drive.result}`);
      else if (at >= 0 && drive.clearance_mm[at] !== null) {
        parts.push(`${drive.planner} ${figure(drive.clearance_mm[at] / 1000)} m clear`);
      }
    }
    this.readout.textContent = parts.join(" · ");
  }
}
