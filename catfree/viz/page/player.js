// Plays the ground plan beside the cameras' pictures, from the data that stand in the page.
"use strict";
(() => {
  const find = (id) => document.getElementById(id);
  const data = JSON.parse(find("player-data").textContent);
  const { frames, labels, rate, people, boxes, cameras, sheet } = data;
  const plan = find("plan"), views = find("views"), slider = find("instant");
  const button = find("play"), readout = find("readout"), speed = find("speed");
  const shows = (layer) => find(`show-${layer}`).checked;
  const TRAIL = 20, AHEAD = 12;
  let at = 0, playing = false, before = 0, enlarged = -1, theme = {};

  const paths = new Map(); // of each identity: [instant, x, y] in order
  for (let i = 0; i < frames.length; i++)
    for (let row = people.start[i]; row < people.start[i + 1]; row++) {
      const id = people.id[row];
      if (id < 0) continue;
      if (!paths.has(id)) paths.set(id, []);
      paths.get(id).push([i, people.x[row], people.y[row]]);
    }

  const images = new Map();
  const imageOf = (i) => {
    if (!sheet || i >= frames.length) return null;
    if (!images.has(i)) {
      const image = new Image();
      image.onload = () => { if (Math.floor(at) === i) draw(); };
      image.onerror = () => { image.missing = true; draw(); };
      image.src = `${sheet.folder}/${String(frames[i]).padStart(6, "0")}.jpg`;
      images.set(i, image);
    }
    return images.get(i);
  };

  const colorOf = (id) => {
    const rgb = id < 0 ? data.untracked : data.colors[id % data.colors.length];
    const lift = theme.dark ? 0.35 : 0; // dark hues are invisible on a dark ground
    return `rgb(${rgb.map((c) => Math.round(c + (255 - c) * lift)).join(" ")})`;
  };

  // A canvas at the resolution of the screen, empty; drawing uses CSS pixels.
  const cleared = (canvas) => {
    const ratio = window.devicePixelRatio || 1, { clientWidth: w, clientHeight: h } = canvas;
    canvas.width = Math.round(w * ratio);
    canvas.height = Math.round(h * ratio);
    const pen = canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.font = "12px system-ui, sans-serif";
    return { pen, w, h };
  };
  const label = (pen, text, x, y, color, ink = "#fff") => {
    const size = parseInt(pen.font, 10);
    pen.fillStyle = color;
    pen.fillRect(x, y - size - 1, pen.measureText(text).width + 4, size + 3);
    pen.fillStyle = ink;
    pen.fillText(text, x + 2, y - 1);
  };
  const line = (pen, points, color, width) => {
    pen.beginPath();
    points.forEach(([x, y], k) => (k ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.strokeStyle = color;
    pen.lineWidth = width;
    pen.stroke();
  };

  const drawPlan = (i) => {
    const { pen, w, h } = cleared(plan), [x0, x1, y0, y1] = data.view;
    const scale = Math.min(w / (x1 - x0), h / (y1 - y0));
    const X = (x) => w / 2 + scale * (x - (x0 + x1) / 2), Y = (y) => h / 2 - scale * (y - (y0 + y1) / 2);
    const map = data.coverage;
    if (map && shows("coverage")) {
      pen.fillStyle = theme.covered;
      map.cells.forEach((row, r) => [...row].forEach((seen, c) => {
        if (seen === "1") {
          const left = Math.round(X(map.x + c * map.dx)), top = Math.round(Y(map.y + (r + 1) * map.dy));
          pen.fillRect(left, top, Math.round(X(map.x + (c + 1) * map.dx)) - left, Math.round(Y(map.y + r * map.dy)) - top);
        }
      }));
    }
    const reachX = w / 2 / scale, reachY = h / 2 / scale, cx = (x0 + x1) / 2, cy = (y0 + y1) / 2;
    for (let k = Math.ceil((cx - reachX) / data.grid); k * data.grid < cx + reachX; k++)
      line(pen, [[X(k * data.grid), 0], [X(k * data.grid), h]], theme.grid, 1);
    for (let k = Math.ceil((cy - reachY) / data.grid); k * data.grid < cy + reachY; k++)
      line(pen, [[0, Y(k * data.grid)], [w, Y(k * data.grid)]], theme.grid, 1);
    for (const { name, wedge } of cameras) {
      if (!wedge) continue;
      const corners = wedge.map(([x, y]) => [X(x), Y(y)]);
      line(pen, [...corners, corners[0]], theme.ink, 1);
      pen.fillStyle = theme.wedge;
      pen.fill();
      const width = pen.measureText(name).width, [x, y] = corners[0];
      pen.fillStyle = theme.muted;
      pen.fillText(name, Math.max(4, Math.min(x - width / 2, w - width - 4)), Math.max(14, Math.min(y - 5, h - 4)));
    }
    const ids = [];
    for (let row = people.start[i]; row < people.start[i + 1]; row++) {
      const x = X(people.x[row]), y = Y(people.y[row]), id = people.id[row], color = colorOf(id);
      if (shows("ellipses") && people.major[row] > 0) {
        pen.beginPath();
        pen.ellipse(x, y, scale * people.major[row], scale * people.minor[row], -people.angle[row], 0, 2 * Math.PI);
        pen.globalAlpha = 0.25;
        pen.fillStyle = color;
        pen.fill();
        pen.globalAlpha = 1;
        pen.lineWidth = 1;
        pen.strokeStyle = color;
        pen.stroke();
      }
      if (shows("trails") && id >= 0) {
        const recent = paths.get(id).filter(([when]) => when <= i && when > i - TRAIL);
        line(pen, recent.map(([, px, py]) => [X(px), Y(py)]), color, 2);
      }
      ids.push([x, y, id, color, people.hollow[row]]);
    }
    for (const [x, y, id, color, hollow] of ids) {
      pen.beginPath();
      pen.arc(x, y, 4.5, 0, 2 * Math.PI);
      pen.fillStyle = hollow ? theme.paper : color;
      pen.fill();
      pen.lineWidth = hollow ? 2 : 1;
      pen.strokeStyle = hollow ? color : theme.paper;
      pen.stroke();
      pen.fillStyle = theme.ink;
      if (id >= 0) pen.fillText(String(id), x + 7, y - 5);
    }
    pen.fillStyle = theme.muted;
    pen.fillText(`grid ${data.grid} ${data.unit}`, 8, h - 8);
  };

  // Where each camera's picture stands on the canvas: left, top, width, height; in the number of
  // columns that makes the pictures largest.
  const layout = (w, h) => {
    const ratio = Math.max(...cameras.map(({ tile }) => tile[3] / tile[2])), count = enlarged < 0 ? cameras.length : 1;
    const widthIn = (columns) => Math.min(w / columns, h / Math.ceil(count / columns) / ratio);
    let columns = 1;
    for (let k = 2; k <= count; k++) if (widthIn(k) > widthIn(columns)) columns = k;
    const width = widthIn(columns), left = (w - columns * width) / 2, rows = Math.ceil(count / columns);
    const top = (h - rows * width * ratio) / 2;
    return cameras.map(({ tile }, c) => {
      if (enlarged >= 0 && c !== enlarged) return null;
      const place = enlarged < 0 ? c : 0, fit = Math.min(width / tile[2], (width * ratio) / tile[3]);
      return [left + (place % columns) * width, top + Math.floor(place / columns) * width * ratio, fit * tile[2], fit * tile[3]];
    });
  };
  const drawViews = (i) => {
    const { pen, w, h } = cleared(views), image = imageOf(i);
    layout(w, h).forEach((place, c) => {
      if (!place) return;
      const [x, y, width, height] = place, { tile, size, name } = cameras[c], zoom = width / size[0];
      pen.save();
      pen.beginPath();
      pen.rect(x, y, width, height);
      pen.clip();
      pen.fillStyle = theme.blank;
      pen.fill();
      if (image && image.complete && image.naturalWidth) pen.drawImage(image, ...tile, x, y, width, height);
      pen.font = enlarged < 0 ? "10px system-ui, sans-serif" : "13px system-ui, sans-serif";
      for (let row = boxes.start[i]; shows("boxes") && row < boxes.start[i + 1]; row++) {
        if (boxes.camera[row] !== c) continue;
        const [a, b, e, f] = boxes.box.slice(4 * row, 4 * row + 4).map((v) => v * zoom), color = colorOf(boxes.id[row]);
        pen.strokeStyle = color;
        pen.lineWidth = enlarged < 0 ? 1.5 : 2.5;
        pen.strokeRect(x + a, y + b, e - a, f - b);
        if (boxes.id[row] >= 0) label(pen, String(boxes.id[row]), x + a, Math.max(y + b, y + 14), color, theme.dark ? "#000" : "#fff");
      }
      pen.font = "12px system-ui, sans-serif";
      label(pen, name, x, y + 14, "rgb(0 0 0 / 65%)");
      if (image && image.missing) label(pen, "The picture is missing.", x, y + 34, "rgb(160 0 0)");
      pen.restore();
      pen.strokeStyle = theme.paper;
      pen.lineWidth = 2;
      pen.strokeRect(x, y, width, height);
    });
  };

  const draw = () => {
    const i = Math.min(Math.floor(at), frames.length - 1);
    drawPlan(i);
    drawViews(i);
    slider.value = i;
    slider.setAttribute("aria-valuetext", labels[i]);
    const count = people.start[i + 1] - people.start[i];
    readout.textContent = `${labels[i]} · ${count} ${count === 1 ? "person" : "people"}`;
    for (let k = 1; k <= AHEAD; k++) imageOf(i + k);
    for (const k of images.keys()) if (Math.abs(k - i) > 4 * AHEAD) images.delete(k);
  };
  const tick = (now) => {
    if (!playing) return;
    // A frame of the screen may have begun before the click.
    const passed = (Math.min(Math.max(now - before, 0), 250) / 1000) * rate * Number(speed.value);
    const next = imageOf(Math.floor(at + passed));
    before = now;
    if (!next || next.complete) {
      const drawn = Math.floor(at);
      at = Math.min(at + passed, frames.length - 1);
      if (Math.floor(at) !== drawn) draw();
      if (at >= frames.length - 1) toggle();
    }
    requestAnimationFrame(tick);
  };
  const toggle = () => {
    playing = !playing;
    button.textContent = playing ? "Pause" : "Play";
    if (!playing) return;
    if (at >= frames.length - 1) at = 0;
    before = performance.now();
    requestAnimationFrame(tick);
  };
  const go = (i) => { at = Math.max(0, Math.min(i, frames.length - 1)); draw(); };
  const enlarge = (camera) => { enlarged = camera < cameras.length && camera !== enlarged ? camera : -1; draw(); };

  button.addEventListener("click", toggle);
  slider.addEventListener("input", () => go(Number(slider.value)));
  document.querySelectorAll(".player input[type=checkbox]").forEach((box) => box.addEventListener("change", draw));
  views.addEventListener("click", (event) => {
    const { offsetX: x, offsetY: y } = event;
    const hit = ([left, top, width, height]) => x >= left && x < left + width && y >= top && y < top + height;
    enlarge(enlarged < 0 ? layout(views.clientWidth, views.clientHeight).findIndex(hit) : -1);
  });
  document.addEventListener("keydown", (event) => {
    const used = event.target.closest("select, summary, a, button, input[type=checkbox], video");
    if (event.altKey || event.ctrlKey || event.metaKey || (used && event.key === " ")) return;
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (event.key === " ") toggle();
    else if (step && !event.target.closest("select, video")) go(Math.floor(at) + step * (event.shiftKey ? 10 : 1));
    else if (/^[0-9]$/.test(event.key) && !event.target.closest("select")) enlarge(Number(event.key) - 1);
    else if (event.key === "Escape") enlarge(-1);
    else return;
    event.preventDefault();
  });

  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const restyle = () => {
    const style = getComputedStyle(document.documentElement);
    const names = ["ink", "paper", "muted", "grid", "wedge", "covered", "blank"];
    theme = Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
    theme.dark = dark.matches;
    draw();
  };
  dark.addEventListener("change", restyle);
  new ResizeObserver(draw).observe(plan.parentElement);
  restyle();
})();
