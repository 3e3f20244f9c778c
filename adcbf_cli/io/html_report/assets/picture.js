// What the top view is made of: each method draws one kind of thing with the scene's pen. Lengths in the data are mm.

const FOOT_PX = 34;

class Picture {
  // Metres from the origin to pixels.
  at(x, y) {
    return [
      this.width / 2 + (x - this.view.x) * this.view.scale,
      (this.height - FOOT_PX) / 2 - (y - this.view.y) * this.view.scale,
    ];
  }

  mm(x, y) { return this.at(x / 1000, y / 1000); }

  px(mm) { return (mm / 1000) * this.view.scale; }

  line(points, close = false) {
    const pen = this.pen;
    pen.beginPath();
    points.forEach(([x, y], k) => (k ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    if (close) pen.closePath();
  }

  grid() {
    const pen = this.pen, step = niceStep(90 / this.view.scale);
    pen.strokeStyle = css("--line");
    pen.fillStyle = css("--muted");
    pen.lineWidth = 1;
    pen.font = "11px system-ui, sans-serif";
    const high = this.height - FOOT_PX;
    const left = this.view.x - this.width / 2 / this.view.scale + this.origin[0];
    const bottom = this.view.y - high / 2 / this.view.scale + this.origin[1];
    const digits = step < 1 ? 1 : 0;
    for (let x = Math.ceil(left / step) * step; ; x += step) {
      const [px] = this.at(x - this.origin[0], 0);
      if (px > this.width) break;
      this.line([[px, 0], [px, high]]);
      pen.stroke();
      if (px > 30) pen.fillText(x.toFixed(digits), px + 3, high - 4);
    }
    for (let y = Math.ceil(bottom / step) * step; ; y += step) {
      const py = this.at(0, y - this.origin[1])[1];
      if (py < 0) break;
      this.line([[0, py], [this.width, py]]);
      pen.stroke();
      if (py < high - 18) pen.fillText(y.toFixed(digits), 3, py - 3);
    }
  }

  points(frame) {
    const pen = this.pen, flat = frame.points || [];
    const size = Math.min(3, Math.max(1.5, this.view.scale * 0.05));
    const palette = [0, 1, 2, 3, 4, 5, 6].map((k) => css(`--c${k}`)), noise = css("--muted");
    for (let k = 0; k < flat.length; k += 3) {
      const [x, y] = this.mm(flat[k], flat[k + 1]);
      pen.fillStyle = flat[k + 2] < 0 ? noise : palette[flat[k + 2] % COLOURS];
      pen.fillRect(x - size / 2, y - size / 2, size, size);
    }
  }

  clusters(frame) {
    const pen = this.pen, flat = frame.clusters;
    pen.strokeStyle = css("--muted");
    pen.lineWidth = 1;
    for (let k = 0; k < flat.length; k += 6) {
      const [x, y, , length, width, yaw] = flat.slice(k, k + 6);
      const c = Math.cos(yaw / 1000) / 2, s = Math.sin(yaw / 1000) / 2;
      this.line([[1, 1], [1, -1], [-1, -1], [-1, 1]].map(
        ([a, b]) => this.mm(x + a * length * c - b * width * s, y + a * length * s + b * width * c)), true);
      pen.stroke();
    }
  }

  ellipse(x, y, xx, xy, yy) {
    const mean = (xx + yy) / 2, turn = Math.hypot((xx - yy) / 2, xy);
    const pen = this.pen, [px, py] = this.mm(x, y);
    pen.beginPath();
    pen.ellipse(px, py, this.px(this.sigmas * Math.sqrt(Math.max(0, mean + turn))),
      this.px(this.sigmas * Math.sqrt(Math.max(0, mean - turn))), -Math.atan2(2 * xy, xx - yy) / 2, 0, 2 * Math.PI);
  }

  predictions(frame) {
    const pen = this.pen;
    const moving = new Map((frame.tracks || []).map((track) => [track[0], track]));
    pen.strokeStyle = pen.fillStyle = css("--predicted");
    pen.lineWidth = 1.2;
    for (const [id, ...flat] of frame.predictions || []) {
      const track = moving.get(id);
      const places = track ? [this.mm(track[2], track[3])] : [];
      for (let k = 0; k < flat.length; k += 5) {
        places.push(this.mm(flat[k], flat[k + 1]));
        const last = k + 5 >= flat.length, half = Math.floor(flat.length / 10) * 5;
        if (!view.layers.ellipses || !(last || k + 5 === half)) continue;
        this.ellipse(...flat.slice(k, k + 5));
        const was = pen.globalAlpha, moves = flat.length > 5;
        pen.globalAlpha = was * 0.06;
        if (moves) pen.fill();
        pen.globalAlpha = was * (moves ? 0.5 : 0.3);
        pen.stroke();
        pen.globalAlpha = was;
      }
      if (flat.length > 5) {
        this.line(places);
        pen.stroke();
      }
    }
  }

  tracks(frame) {
    const pen = this.pen;
    pen.font = "11px system-ui, sans-serif";
    for (const [id, state, x, y, vx, vy, xx, xy, yy, radius] of frame.tracks || []) {
      const [px, py] = this.mm(x, y), selected = view.track[this.number] === id;
      pen.strokeStyle = pen.fillStyle = css(state === 2 ? "--standing" : state === 1 ? "--moving" : "--muted");
      pen.lineWidth = selected ? 3 : state === 1 ? 2 : 1.3;
      pen.setLineDash(state === 3 ? [4, 3] : state === 0 ? [1, 3] : []);
      pen.beginPath();
      pen.arc(px, py, Math.max(2, this.px(radius)), 0, 2 * Math.PI);
      pen.stroke();
      pen.setLineDash([]);
      if (view.layers.ellipses) {
        this.ellipse(x, y, xx, xy, yy);
        const was = pen.globalAlpha;
        pen.globalAlpha = was * 0.3;
        pen.fill();
        pen.globalAlpha = was;
      }
      if (state === 1) {
        this.line([[px, py], this.mm(x + vx, y + vy)]);
        pen.stroke();
      }
      if (view.layers.labels && (state === 1 || selected)) {
        pen.fillText(`${id}`, px + this.px(radius) + 3, py - 3);
      }
    }
  }

  reference(route) {
    const pen = this.pen, flat = route.xy_mm;
    pen.strokeStyle = pen.fillStyle = css("--fg");
    pen.lineWidth = 1.2;
    pen.setLineDash([7, 5]);
    const points = [];
    for (let k = 0; k < flat.length; k += 2) points.push(this.mm(flat[k], flat[k + 1]));
    this.line(points);
    pen.stroke();
    pen.setLineDash([]);
    const [x, y] = this.mm(...route.goal_mm);
    pen.beginPath();
    pen.arc(x, y, 6, 0, 2 * Math.PI);
    pen.stroke();
    pen.beginPath();
    pen.arc(x, y, 2, 0, 2 * Math.PI);
    pen.fill();
    if (view.layers.labels) pen.fillText("goal", x + 9, y + 4);
  }

  logPath(frame) {
    const pen = this.pen, shown = this.run.scene.shown;
    if (!view.layers.paths || !frame || !frame.sensor) return;
    const upTo = lastUpTo(this.run.frameTimes, view.t_ms);
    pen.strokeStyle = css("--muted");
    pen.lineWidth = 1.5;
    this.line(shown.slice(0, upTo + 1).filter((each) => each.sensor).map((each) => this.mm(each.sensor[0], each.sensor[1])));
    pen.stroke();
    this.vehicle(...frame.sensor, css("--muted"), null);
  }

  vehicle(x, y, yaw, colour, radius) {
    const pen = this.pen, [px, py] = this.mm(x, y), a = -yaw / 1000;
    if (radius) {
      pen.strokeStyle = colour;
      pen.lineWidth = 2;
      pen.beginPath();
      pen.arc(px, py, this.px(radius * 1000), 0, 2 * Math.PI);
      pen.stroke();
    }
    pen.fillStyle = colour;
    const tip = (turn, far) => [px + far * Math.cos(a + turn), py + far * Math.sin(a + turn)];
    this.line([tip(0, 9), tip(2.5, 7), tip(-2.5, 7)], true);
    pen.fill();
  }

  drive(drive, group, together) {
    const pen = this.pen, colour = planColour(drive.planner);
    const at = lastUpTo(drive.t_ms, view.t_ms);
    if (at < 0) return;
    if (view.layers.plans && drive.plans) this.plan(drive, colour);
    if (!view.layers.paths) return;
    pen.strokeStyle = colour;
    pen.lineWidth = 2.2;
    pen.setLineDash(planDash(drive.planner));
    const places = [];
    for (let k = 0; k <= at; k += 1) places.push(this.mm(drive.x_mm[k], drive.y_mm[k]));
    this.line(places);
    pen.stroke();
    pen.setLineDash([]);
    this.vehicle(drive.x_mm[at], drive.y_mm[at], drive.yaw_mrad[at], colour, group.body_radius_m);
    const over = at === drive.t_ms.length - 1;
    const [x, y] = places[at];
    if (over && drive.result && drive.result !== "success") {
      pen.lineWidth = 3;
      this.line([[x - 7, y - 7], [x + 7, y + 7]]);
      pen.stroke();
      this.line([[x - 7, y + 7], [x + 7, y - 7]]);
      pen.stroke();
    }
    if (view.layers.labels && (together < 2 || (over && drive.result && drive.result !== "success"))) {
      pen.fillStyle = colour;
      pen.fillText(drive.planner + (over && drive.result ? `: ${drive.result}` : ""), x + 14, y - 8);
    }
  }

  plan(drive, colour) {
    const pen = this.pen, index = lastUpTo(drive.plans.t_ms, view.t_ms);
    if (index < 0 || view.t_ms > drive.t_ms[drive.t_ms.length - 1]) return;
    const flat = drive.plans.xy_mm[index], places = [];
    for (let k = 0; k < flat.length; k += 2) {
      if (flat[k] !== null) places.push(this.mm(flat[k], flat[k + 1]));
    }
    pen.strokeStyle = pen.fillStyle = colour;
    pen.lineWidth = 1.2;
    this.line(places);
    pen.stroke();
    for (const [x, y] of places) pen.fillRect(x - 1.5, y - 1.5, 3, 3);
  }

  // A scale bar and the axes' names, below the picture.
  foot() {
    const pen = this.pen, step = niceStep(90 / this.view.scale), y = this.height - 12;
    pen.fillStyle = css("--bg");
    pen.fillRect(0, this.height - FOOT_PX, this.width + 1, FOOT_PX + 1);
    pen.strokeStyle = pen.fillStyle = css("--fg");
    pen.lineWidth = 2;
    this.line([[8, y - 5], [8, y], [8 + step * this.view.scale, y], [8 + step * this.view.scale, y - 5]]);
    pen.stroke();
    pen.font = "12px system-ui, sans-serif";
    pen.fillText(`${step < 1 ? step.toFixed(1) : step} m`, 14 + step * this.view.scale, y);
    if (this.width < 480) return;
    pen.textAlign = "right";
    pen.fillText("x to the right, y up, world frame, m", this.width - 6, y);
  }
}

// 1, 2 or 5 times a power of ten, at least `least`.
function niceStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((each) => each * power).find((each) => each >= least * 0.999);
}
