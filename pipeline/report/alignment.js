/* The aligned sections, to scroll through and to lay over each other. Takes the pictures and what
 * is known of each from the row beside it (html_alignment.c); micrometres of the block frame. */
"use strict";
(async () => {
const $ = id => document.getElementById("align-" + id);
const root = document.getElementById("align"), view = $("view"), slice = $("slice"), strip = $("strip");
const corner = [+root.dataset.x, +root.dataset.y], um = +root.dataset.um;
const two = text => text.split(" ").map(Number);
const sections = [...$("row").children].map(figure => ({
  name: figure.querySelector("b").textContent, picture: figure.querySelector("img"),
  serial: +figure.dataset.serial, z: +figure.dataset.z, state: figure.dataset.state,
  marks: figure.dataset.marks.split(",").map(mark => mark && two(mark)),
  tre: figure.dataset.tre, tissue: figure.dataset.tissue && two(figure.dataset.tissue),
}));
await Promise.all(sections.map(s => s.picture.decode()));
const N = sections.length, side = sections[0].picture.naturalWidth, wideUm = side * um;
const slab = sections.reduce((least, s, i) => i ? Math.min(least, s.z - sections[i - 1].z || least)
  : least, Infinity);
const off = mark => Math.hypot(mark[2], mark[3]);
const residuals = sections.flatMap(s => s.marks.filter(Boolean).map(off)).sort((a, b) => a - b);
const roundUp = least => {
  const ten = 10 ** Math.floor(Math.log10(least));
  return ten * [1, 2, 5, 10].find(n => n * ten >= least * (1 - 1e-9));
};
const roundDown = most => {
  const ten = 10 ** Math.floor(Math.log10(most));
  return ten * [5, 2, 1].find(n => n * ten <= most * (1 + 1e-9));
};
/* So that most arrows are seen, and none but a gross one leaves the picture. */
const typical = residuals[Math.floor(.9 * (residuals.length - 1))] || 0;
const larger = typical > 0 ? Math.max(1, roundDown(.08 * wideUm / typical)) : 1;
const SHAPES = ["--fuchsin", "--picric", "--blue"], INKS = ["#a5184f", "#b07d00", "#2f6690"];

/* ---- what is shown ---- */

let k, eye, playing = 0, turn = 0, wide = 0, tall = 0, due = 0;
const field = name => $(name).value;
/* The section that the one shown is compared with; the middle one's own partner is the next. */
function partner() {
  const how = field("with"), middle = N >> 1;
  if (how === "middle") return k === middle ? Math.min(k + 1, N - 1) : middle;
  const other = k + Number(how);
  return other < 0 || other >= N ? k - Number(how) : other;
}
const scale = () => Math.min(wide, tall) / wideUm * eye.zoom; /* pixels of the screen a micrometre */
const toScreen = (x, y) => [wide / 2 + eye.x + (x - corner[0] - wideUm / 2) * scale(),
                            tall / 2 + eye.y + (y - corner[1] - wideUm / 2) * scale()];
const sideY = () => corner[1] + field("side") / 1000 * wideUm;
function ink(name) { return getComputedStyle(root).getPropertyValue(name).trim(); }
function pen(canvas) {
  const to = canvas.getContext("2d"), ratio = Math.min(2, devicePixelRatio || 1);
  const w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== w || canvas.height !== h) {
    canvas.width = w;
    canvas.height = h;
  }
  to.setTransform(ratio, 0, 0, ratio, 0, 0);
  to.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
  to.font = "12px " + getComputedStyle(root).fontFamily;
  return to;
}
/* Letters and lines that are read on tissue as on glass. */
function write(to, text, x, y) {
  to.lineWidth = 3;
  to.lineJoin = "round";
  to.strokeStyle = "#fff";
  to.strokeText(text, x, y);
  to.fillText(text, x, y);
}
function lay(to, picture) {
  to.drawImage(picture, ...toScreen(...corner), wideUm * scale(), wideUm * scale());
}
/* Where both are as dark it is grey; what this section alone has is magenta, the other's green. */
const darkness = [];
function darknessOf(i) {
  if (darkness[i]) return darkness[i];
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = side;
  const to = canvas.getContext("2d", { willReadFrequently: true });
  to.drawImage(sections[i].picture, 0, 0);
  const rgb = to.getImageData(0, 0, side, side).data, out = new Uint8Array(side * side);
  for (let n = 0; n < out.length; n++)
    out[n] = (54 * rgb[4 * n] + 183 * rgb[4 * n + 1] + 19 * rgb[4 * n + 2]) >> 8;
  return darkness[i] = out;
}
let pair = "", paired;
function colours(a, b) {
  if (pair === a + " " + b) return paired;
  pair = a + " " + b;
  paired ||= Object.assign(document.createElement("canvas"), { width: side, height: side });
  const to = paired.getContext("2d"), both = to.createImageData(side, side);
  const own = darknessOf(a), other = darknessOf(b);
  for (let n = 0; n < own.length; n++) {
    both.data[4 * n] = both.data[4 * n + 2] = other[n];
    both.data[4 * n + 1] = own[n];
    both.data[4 * n + 3] = 255;
  }
  to.putImageData(both, 0, 0);
  return paired;
}
function drawPictures(to) {
  const other = partner(), own = sections[k].picture, with_ = sections[other].picture;
  const how = field("show");
  if (how === "colours") return lay(to, colours(k, other));
  lay(to, how === "flicker" && turn ? with_ : own);
  if (how === "blend") {
    to.globalAlpha = .5;
    lay(to, with_);
    to.globalAlpha = 1;
  } else if (how === "board") {
    const squares = +field("square");
    to.save();
    to.beginPath();
    for (let j = 0; j < squares; j++)
      for (let i = (j + 1) % 2; i < squares; i += 2) {
        const at = [i, j].map((n, c) => corner[c] + n / squares * wideUm);
        to.rect(...toScreen(...at), wideUm / squares * scale(), wideUm / squares * scale());
      }
    to.clip();
    lay(to, with_);
    to.restore();
  }
}
/* A mark's shape is the same in the chart of residuals; on a picture, which is white in the dark
 * too, its ink is the light page's. */
function drawShape(to, mark, x, y, size) {
  to.beginPath();
  if (mark === 0) to.arc(x, y, size, 0, 2 * Math.PI);
  else if (mark === 1) to.rect(x - .9 * size, y - .9 * size, 1.8 * size, 1.8 * size);
  else {
    to.moveTo(x, y - 1.2 * size);
    to.lineTo(x + 1.1 * size, y + .8 * size);
    to.lineTo(x - 1.1 * size, y + .8 * size);
    to.closePath();
  }
}
function drawArrow(to, mark, i) {
  const from = toScreen(mark[0], mark[1]);
  const tip = toScreen(mark[0] + larger * mark[2], mark[1] + larger * mark[3]);
  const long = Math.hypot(tip[0] - from[0], tip[1] - from[1]);
  const way = long > 0 ? tip.map((v, c) => (v - from[c]) / long) : [0, 0], head = Math.min(8, long);
  for (const [style, width] of [["#fff", 5], [INKS[i], 2.2]]) {
    to.strokeStyle = style;
    to.lineWidth = width;
    to.lineJoin = to.lineCap = "round";
    drawShape(to, i, ...from, 4.5);
    to.stroke();
    to.beginPath();
    to.moveTo(...from);
    to.lineTo(...tip);
    for (const turned of [-1, 1]) {
      to.moveTo(...tip);
      to.lineTo(tip[0] - head * (way[0] + .6 * turned * way[1]),
                tip[1] - head * (way[1] - .6 * turned * way[0]));
    }
    to.stroke();
  }
  to.fillStyle = INKS[i];
  to.textAlign = from[0] > wide / 2 ? "right" : "left";
  to.textBaseline = way[1] > 0 ? "bottom" : "top";
  write(to, off(mark).toFixed(1) + " µm", from[0] + (from[0] > wide / 2 ? -9 : 9),
        from[1] + (way[1] > 0 ? -7 : 7));
}
function drawBar(to, text, times, right) {
  const most = .22 * wide / scale() / times, bar = roundDown(most), long = bar * times * scale();
  const x = right ? wide - 12 - long : 12;
  to.fillStyle = "#fff";
  to.fillRect(x - 1.5, tall - 13.5, long + 3, 6);
  to.fillStyle = "#22262b";
  to.fillRect(x, tall - 12, long, 3);
  to.textAlign = right ? "right" : "left";
  to.textBaseline = "bottom";
  write(to, text + (bar >= 1000 ? bar / 1000 + " mm" : bar + " µm"), right ? wide - 12 : 12,
        tall - 16);
}
function drawView() {
  const to = pen(view);
  to.fillStyle = "#fff";
  to.fillRect(0, 0, wide, tall);
  drawPictures(to);
  const y = toScreen(0, sideY())[1];
  to.setLineDash([5, 5]);
  to.lineWidth = 1;
  to.strokeStyle = "#22262b";
  to.beginPath();
  to.moveTo(0, y);
  to.lineTo(wide, y);
  to.stroke();
  to.setLineDash([]);
  if ($("arrows").checked) {
    sections[k].marks.forEach((mark, i) => mark && drawArrow(to, mark, i));
    if (typical > 0) drawBar(to, `arrows ×${larger}: `, larger, true);
  }
  drawBar(to, "", 1, false);
  const other = sections[partner()].name, how = field("show");
  to.fillStyle = "#22262b";
  to.textAlign = "left";
  to.textBaseline = "top";
  to.font = "600 " + to.font;
  write(to, how === "alone" ? sections[k].name : how === "flicker" ? turn ? other : sections[k].name
    : how === "colours" ? `${sections[k].name} magenta, ${other} green`
    : `${sections[k].name} and ${other}`, 12, 10);
}
/* One row of every picture, at the depth of its section. */
function drawSlice() {
  const to = pen(slice), high = slice.clientHeight, first = sections[0].z;
  const long = sections[N - 1].z - first + slab, each = slab / long * high;
  const row = Math.min(side - 1, Math.floor((sideY() - corner[1]) / um));
  const left = toScreen(...corner)[0];
  const at = i => (sections[i].z - first) / long * high;
  sections.forEach((s, i) => {
    const y = Math.round(at(i)); /* whole pixels, or the seams would show as lines */
    to.drawImage(s.picture, 0, row, side, 1, left, y, wideUm * scale(),
                 Math.max(1, Math.round(at(i) + each) - y));
  });
  for (const [i, style] of [[partner(), ink("--soft")], [k, ink("--fuchsin")]]) {
    const y = at(i) + each / 2;
    to.fillStyle = style;
    for (const [x, way] of [[0, 1], [wide, -1]]) {
      to.beginPath();
      to.moveTo(x, y - 6);
      to.lineTo(x + 9 * way, y);
      to.lineTo(x, y + 6);
      to.fill();
    }
  }
  const times = high / long / scale();
  to.fillStyle = "#22262b";
  to.textAlign = "left";
  to.textBaseline = "top";
  write(to, `side view, z ×${times < 10 ? times.toFixed(1) : Math.round(times)}`, 14, 6);
}
function drawStrip() {
  const to = pen(strip), w = strip.clientWidth, h = strip.clientHeight, left = 40, right = w - 12;
  const top = 20, bottom = h - 22, first = sections[0].serial, last = sections[N - 1].serial;
  const values = residuals.length ? residuals : sections.map(s => +s.tre || 0);
  const most = roundUp(Math.max(.5, ...values));
  const x = serial => left + (serial - first + .5) / (last - first + 1) * (right - left);
  const y = value => bottom - value / most * (bottom - top);
  const axis = ink("--line"), soft = ink("--soft");
  to.fillStyle = soft;
  to.strokeStyle = axis;
  to.lineWidth = 1;
  to.textBaseline = "middle";
  to.textAlign = "right";
  for (const value of [0, most / 2, most]) {
    to.fillText(+value.toPrecision(3), left - 6, y(value));
    to.beginPath();
    to.moveTo(left, y(value));
    to.lineTo(right, y(value));
    to.stroke();
  }
  to.textAlign = "left";
  to.fillText(residuals.length ? "residuals of the marks, µm" : "predicted error, µm", left, 8);
  to.textBaseline = "bottom";
  to.fillText(sections[0].name, left, h - 2);
  to.textAlign = "right";
  to.fillText(sections[N - 1].name, right, h - 2);
  for (const [i, style, width] of [[partner(), soft, 1], [k, ink("--ink"), 2]]) {
    to.strokeStyle = style;
    to.lineWidth = width;
    to.beginPath();
    to.moveTo(x(sections[i].serial), top - 4);
    to.lineTo(x(sections[i].serial), bottom + 4);
    to.stroke();
  }
  for (const s of sections) {
    if (!residuals.length) {
      to.fillStyle = soft;
      drawShape(to, 0, x(s.serial), y(+s.tre || 0), 2.5);
      to.fill();
    }
    s.marks.forEach((mark, i) => {
      if (!mark) return;
      to.fillStyle = ink(SHAPES[i]);
      drawShape(to, i, x(s.serial), y(off(mark)), 2.8);
      to.fill();
    });
  }
}
function make(kind, text) {
  const element = document.createElement(kind);
  if (text) element.textContent = text;
  return element;
}
function tell() {
  const s = sections[k], other = sections[partner()], list = make("dl"), head = make("h3");
  const slot = document.getElementById("section-" + s.serial), link = make("a", "Section " + s.name);
  const apart = +(other.z - s.z).toFixed(3), rows = [["State", s.state], ["z", s.z + " µm"]];
  s.marks.forEach((mark, i) => rows.push([`Mark ${i + 1}`, mark ? off(mark).toFixed(1) + " µm" : "–"]));
  if (s.tre) rows.push(["Error predicted at the region", s.tre + " µm"]);
  if (s.tissue)
    rows.push(["Off by its neighbours' tissue", s.tissue[0].toFixed(1) + " µm"],
              ["which is usual here up to", s.tissue[1].toFixed(0) + " µm"]);
  for (const [name, value] of rows) list.append(make("dt", name), make("dd", value));
  if (slot) link.href = "#" + slot.id;
  head.append(link);
  $("told").replaceChildren(head, list);
  const large = slot && slot.querySelector("a.glass");
  if (large) {
    const to = make("a", "All that the scanner saw, what is not measured, the density");
    to.href = large.getAttribute("href");
    $("told").append(to);
  }
  for (const flag of slot ? slot.querySelectorAll(".flag, .turned") : [])
    $("told").append(flag.cloneNode(true));
  if (field("show") !== "alone")
    $("told").append(make("p", `Shown with ${other.name}, ${Math.abs(apart)} µm ` +
                          (apart < 0 ? "before it." : "behind it.")));
  if (typical > 0 && $("arrows").checked)
    $("told").append(make("p", `Arrows are ${larger} times as long as the residuals; they begin ` +
                          "where the common triangle has the mark."));
  $("section-said").textContent = `${s.name}, ${k + 1} of ${N}`;
  $("side-said").textContent = Math.round(sideY()).toString().replace("-", "−") + " µm";
  $("square-said").textContent = Math.round(wideUm / field("square")) + " µm";
  $("square").disabled = field("show") !== "board";
}
function draw() {
  due = 0;
  drawView();
  drawSlice();
  drawStrip();
  root.dataset.drawn = +(root.dataset.drawn || 0) + 1;
}
function later() { due ||= requestAnimationFrame(draw); }
function changed() {
  tell();
  later();
}
function go(to) {
  k = Math.max(0, Math.min(N - 1, to));
  $("section").value = k;
  changed();
}
function resize() {
  wide = view.clientWidth;
  tall = view.clientHeight;
  later();
}

/* ---- hands ---- */

function zoom(by) {
  const was = eye.zoom;
  eye.zoom = Math.max(1, Math.min(12, eye.zoom * by));
  eye.x = eye.zoom === 1 ? 0 : eye.x * eye.zoom / was;
  eye.y = eye.zoom === 1 ? 0 : eye.y * eye.zoom / was;
  view.classList.toggle("near", eye.zoom > 1);
  later();
}
function play(on) {
  clearInterval(playing);
  playing = on ? setInterval(() => go((k + 1) % N), 250) : 0;
  $("play").textContent = on ? "Stop" : "Play";
}
setInterval(() => {
  if (field("show") !== "flicker" || document.hidden) return;
  turn = 1 - turn;
  later();
}, 450);
function home() {
  play(false);
  for (const [name, value] of [["show", "board"], ["with", "1"], ["square", 8], ["side", 500]])
    $(name).value = value;
  $("arrows").checked = true;
  eye = { zoom: 1, x: 0, y: 0 };
  view.classList.remove("near");
  go(N >> 1);
}
const pointers = new Map();
let moved = 0, pinch = 0, left = 0;
view.addEventListener("pointerdown", e => {
  pointers.set(e.pointerId, [e.clientX, e.clientY]);
  view.setPointerCapture(e.pointerId);
  moved = pointers.size > 1 ? 99 : 0;
  pinch = left = 0;
});
view.addEventListener("pointermove", e => {
  const was = pointers.get(e.pointerId);
  if (!was) return;
  const dx = e.clientX - was[0], dy = e.clientY - was[1];
  pointers.set(e.pointerId, [e.clientX, e.clientY]);
  moved += Math.abs(dx) + Math.abs(dy);
  if (pointers.size > 1) {
    const [p, q] = [...pointers.values()], apart = Math.hypot(p[0] - q[0], p[1] - q[1]);
    eye.x += dx / 2;
    eye.y += dy / 2;
    if (pinch) zoom(apart / pinch);
    pinch = apart;
  } else if (eye.zoom > 1) {
    eye.x += dx;
    eye.y += dy;
    later();
  } else if (Math.abs(left += dx) >= 14) { /* a finger's width is three sections */
    go(k - Math.trunc(left / 14));
    left %= 14;
  }
});
for (const name of ["pointerup", "pointercancel"])
  view.addEventListener(name, e => {
    const alone = pointers.size === 1;
    pointers.delete(e.pointerId);
    if (name === "pointercancel" || !alone || moved >= 5 || e.button !== 0) return;
    const box = view.getBoundingClientRect(), y = e.clientY - box.top;
    $("side").value = 500 + 1000 * (y - tall / 2 - eye.y) / scale() / wideUm;
    changed();
  });
/* Where the pictures have the focus, or with the key held: a page that is read is scrolled past. */
view.addEventListener("wheel", e => {
  if (!e.ctrlKey && document.activeElement !== view) return;
  e.preventDefault();
  if (e.ctrlKey) zoom(Math.exp(-e.deltaY / 500));
  else go(k + Math.sign(e.deltaY));
}, { passive: false });
view.addEventListener("keydown", e => {
  const show = $("show");
  const keys = {
    ArrowLeft: () => go(k - 1), ArrowUp: () => go(k - 1),
    ArrowRight: () => go(k + 1), ArrowDown: () => go(k + 1),
    PageUp: () => go(k - 10), PageDown: () => go(k + 10),
    Home: () => go(0), End: () => go(N - 1), " ": () => play(!playing),
    "+": () => zoom(1.3), "=": () => zoom(1.3), "-": () => zoom(1 / 1.3), "0": home,
    c: () => {
      show.selectedIndex = (show.selectedIndex + 1) % show.options.length;
      changed();
    },
  };
  if (!keys[e.key] || e.ctrlKey || e.metaKey || e.altKey) return;
  e.preventDefault();
  keys[e.key]();
});
for (const canvas of [slice, strip])
  canvas.addEventListener("click", e => {
    const box = canvas.getBoundingClientRect(), first = sections[0], last = sections[N - 1];
    const where = canvas === slice
      ? s => (s.z - first.z + slab / 2) / (last.z - first.z + slab) * box.height - (e.clientY - box.top)
      : s => 40 + (s.serial - first.serial + .5) / (last.serial - first.serial + 1) * (box.width - 52)
             - (e.clientX - box.left);
    go(sections.reduce((best, s, i) =>
      Math.abs(where(s)) < Math.abs(where(sections[best])) ? i : best, 0));
  });
$("section").addEventListener("input", () => go(+field("section")));
$("back").addEventListener("click", () => go(k - 1));
$("on").addEventListener("click", () => go(k + 1));
$("play").addEventListener("click", () => play(!playing));
$("home").addEventListener("click", home);
for (const name of ["show", "with", "square", "side", "arrows"])
  $(name).addEventListener("input", changed);

$("section").max = N - 1;
root.hidden = false;
$("row").hidden = true;
home();
resize();
new ResizeObserver(resize).observe(view);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", later);
})();
