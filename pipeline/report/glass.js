/* A section, large, with what of it is not measured and its density laid over it. Takes pictures
 * and what is known of each from the row below (html_glass.c); micrometres of the block frame. */
"use strict";
(async () => {
const $ = id => document.getElementById("glass-" + id);
const root = document.getElementById("glass"), stage = $("stage"), view = $("view"), scale = $("scale");
const d = root.dataset, corner = [+d.x, +d.y], um = +d.um, reasons = d.reasons.split(",");
const low = +d.low, high = +d.high;
const sections = [...$("row").children].map(figure => ({
  name: figure.querySelector("b").textContent, serial: +figure.dataset.serial, z: +figure.dataset.z,
  state: figure.dataset.state, flags: [...figure.querySelectorAll(".flag")],
  marks: figure.dataset.marks.split(",").map(mark => mark && mark.split(" ").map(Number)),
  picture: figure.querySelector("img"), masked: figure.querySelector(".masked img"),
  density: figure.querySelector(".density img"),
}));
const N = sections.length, wideUm = sections[0].picture.getAttribute("width") * um;
const MAP = [68, 1, 84, 72, 24, 106, 71, 45, 123, 66, 64, 134, 59, 82, 139, 51, 99, 141, 44, 114,
  142, 38, 130, 142, 33, 145, 140, 31, 160, 136, 40, 174, 128, 63, 188, 115, 94, 201, 98, 132, 212,
  75, 173, 220, 48, 216, 226, 25, 253, 231, 37]; /* viridis */
/* Of the reasons, in their order; no two neighbours look alike to a colour-blind eye. */
const INKS = [[0, 114, 178], [213, 94, 0], [240, 228, 66], [0, 158, 115], [204, 121, 167],
  [86, 180, 233], [230, 159, 0], [120, 60, 160], [90, 90, 90], [0, 0, 0]];
function viridis(t, c) {
  const at = Math.min(1, Math.max(0, t)) * 16, k = Math.min(15, Math.floor(at));
  return MAP[3 * k + c] + (at - k) * (MAP[3 * k + 3 + c] - MAP[3 * k + c]);
}
function ink(name) { return getComputedStyle(root).getPropertyValue(name).trim(); }

/* ---- layers ---- */

/* The codes of a picture, and a canvas of its size to colour. */
async function codesOf(img) {
  if (!img) return null;
  await img.decode();
  const canvas = Object.assign(document.createElement("canvas"),
    { width: img.naturalWidth, height: img.naturalHeight });
  const to = canvas.getContext("2d", { willReadFrequently: true });
  to.drawImage(img, 0, 0);
  const pixels = to.getImageData(0, 0, canvas.width, canvas.height);
  return { canvas, to, pixels, codes: pixels.data.slice(), wide: canvas.width, high: canvas.height };
}
function colour(layer, of) {
  for (let n = 0; n < layer.wide * layer.high; n++) layer.pixels.data.set(of(n), 4 * n);
  layer.to.putImageData(layer.pixels, 0, 0);
}
const NOTHING = [0, 0, 0, 0];
async function load(i) {
  const s = sections[i];
  await s.picture.decode();
  const masked = await codesOf(s.masked), density = await codesOf(s.density);
  if (masked) colour(masked, n => {
    const code = masked.codes[4 * n];
    return code ? [...INKS[(code - 1) % INKS.length], 170] : NOTHING;
  });
  if (density) {
    const region = Object.assign(document.createElement("canvas"),
      { width: density.wide, height: density.high }), pen = region.getContext("2d");
    const inside = n => density.codes[4 * n + 1] > 0;
    pen.fillStyle = "#ffffff";
    for (let n = 0; n < density.wide * density.high; n++) {
      const x = n % density.wide, ends = x === 0 || x === density.wide - 1 ||
        n < density.wide || n >= density.wide * (density.high - 1);
      if (inside(n) && (ends || !inside(n - 1) || !inside(n + 1) || !inside(n - density.wide) ||
          !inside(n + density.wide))) pen.fillRect(x, Math.floor(n / density.wide), 1, 1);
    }
    colour(density, n => {
      const code = density.codes[4 * n];
      return code ? [0, 1, 2].map(c => viridis((code - 1) / 254, c)).concat(255) : NOTHING;
    });
    density.region = region;
  }
  return { masked, density };
}
/* Those of a section and its neighbours are kept; null: they are on their way. */
const kept = new Map();
function layersOf(i) {
  if (!kept.has(i)) {
    for (const other of kept.keys()) if (Math.abs(other - i) > 2) kept.delete(other);
    kept.set(i, null);
    load(i).then(layers => {
      if (kept.has(i)) kept.set(i, layers);
      later();
    });
  }
  return kept.get(i);
}

/* ---- what is shown ---- */

let k = 0, turn = 0, due = 0, place = null;
const field = name => $(name).value, tick = name => $(name).checked;
function partner() {
  const to = k + Number(field("with"));
  return to < 0 || to >= N ? k : to;
}
const perUm = () => view.width / wideUm;
function lay(to, canvas, x, y, w, h) {
  to.drawImage(canvas, (x - corner[0]) * perUm(), (y - corner[1]) * perUm(), w * perUm(), h * perUm());
}
function layDensity(to, canvas) {
  lay(to, canvas, +d.densityX, +d.densityY, canvas.width * d.densityUmX, canvas.height * d.densityUmY);
}
function drawMarks(to, s) {
  to.lineWidth = 2 * ratio();
  s.marks.forEach((mark, i) => {
    if (!mark) return;
    to.strokeStyle = ink(["--fuchsin", "--picric", "--blue"][i]);
    to.beginPath();
    to.arc((mark[0] + mark[2] - corner[0]) * perUm(), (mark[1] + mark[3] - corner[1]) * perUm(),
      16 * ratio(), 0, 7);
    to.stroke();
  });
}
const ratio = () => Math.min(2, devicePixelRatio || 1);
function draw() {
  due = 0;
  const i = turn ? partner() : k, s = sections[i], layers = layersOf(i);
  if (!layers) return;
  const to = view.getContext("2d");
  to.imageSmoothingQuality = "high";
  to.globalAlpha = 1;
  to.imageSmoothingEnabled = true;
  to.drawImage(s.picture, 0, 0, view.width, view.height);
  to.imageSmoothingEnabled = false;
  if (layers.density && +field("density")) {
    to.globalAlpha = field("density") / 100;
    layDensity(to, layers.density.canvas);
    to.globalAlpha = 1;
  }
  if (layers.masked && tick("masked"))
    lay(to, layers.masked.canvas, ...corner, layers.masked.wide * d.maskedUm,
      layers.masked.high * d.maskedUm);
  if (layers.density && tick("region")) {
    to.globalAlpha = .8;
    layDensity(to, layers.density.region);
    to.globalAlpha = 1;
  }
  if (tick("marks")) drawMarks(to, s);
  if (field("with") !== "0") {
    to.font = `${14 * ratio()}px ${getComputedStyle(root).fontFamily}`;
    to.lineWidth = 3 * ratio();
    to.strokeStyle = "#ffffff";
    to.fillStyle = "#22262b";
    to.strokeText(s.name, 12 * ratio(), 22 * ratio());
    to.fillText(s.name, 12 * ratio(), 22 * ratio());
  }
  tell();
  root.dataset.drawn = +(root.dataset.drawn || 0) + 1;
}
function later() { due ||= requestAnimationFrame(draw); }
function drawScale() {
  const w = scale.width = scale.clientWidth * ratio(), h = scale.height = scale.clientHeight * ratio();
  const to = scale.getContext("2d"), left = 12 * ratio(), right = w - left;
  scale.hidden = !sections.some(s => s.density);
  for (let x = left; x < right; x++) {
    const t = (x - left) / (right - left);
    to.fillStyle = `rgb(${[0, 1, 2].map(c => Math.round(viridis(t, c))).join(" ")})`;
    to.fillRect(x, 8 * ratio(), 1, 14 * ratio());
  }
  to.fillStyle = ink("--soft");
  to.font = `${12 * ratio()}px ${getComputedStyle(root).fontFamily}`;
  to.textBaseline = "top";
  for (const [align, at, t] of [["left", left, 0], ["center", w / 2, .5], ["right", right, 1]]) {
    to.textAlign = align;
    to.fillText((t === .5 ? "density " : "") + said(low + t * (high - low)), at, h / 2);
  }
}
const said = value => value.toFixed(2).replace("-", "−");
function make(kind, text) {
  const element = document.createElement(kind);
  if (text) element.textContent = text;
  return element;
}
/* What the layers have at a place of the block. */
function rowsAt([x, y], { masked, density }) {
  const rows = [["x, y", `${Math.round(x)}, ${Math.round(y)} µm`.replace(/-/g, "−")]];
  if (density) {
    const u = Math.floor((x - d.densityX) / d.densityUmX), v = Math.floor((y - d.densityY) / d.densityUmY);
    const n = u >= 0 && v >= 0 && u < density.wide && v < density.high ? 4 * (v * density.wide + u) : -1;
    const code = n < 0 ? 0 : density.codes[n];
    rows.push(["Density", code ? said(low + (code - 1) / 254 * (high - low)) : "not known"],
      ["In the region", n >= 0 && density.codes[n + 1] ? "yes" : "no"]);
  }
  if (masked) {
    const u = Math.floor((x - corner[0]) / d.maskedUm), v = Math.floor((y - corner[1]) / d.maskedUm);
    const code = masked.codes[4 * (v * masked.wide + u)];
    if (code) rows.push(["Not measured", reasons[code - 1]]);
  }
  return rows;
}
function tell() {
  const s = sections[k], layers = layersOf(k), list = make("dl"), rows = [["State", s.state]];
  const link = make("a", "In the report");
  rows.push(["z", s.z + " µm"]);
  if (place && layers) rows.push(...rowsAt(place, layers));
  for (const [name, value] of rows) list.append(make("dt", name), make("dd", value));
  link.href = "report.html#section-" + s.serial;
  $("told").replaceChildren(make("h3", "Section " + s.name), list);
  for (const flag of s.flags) $("told").append(make("p", flag.textContent));
  if (layers && layers.masked && tick("masked")) {
    const found = new Set();
    for (let n = 0; n < layers.masked.codes.length; n += 4) found.add(layers.masked.codes[n]);
    const legend = make("p");
    for (const code of [...found].filter(Boolean).sort((a, b) => a - b)) {
      const key = make("span"), item = make("span", reasons[code - 1]);
      key.className = "key";
      key.style.background = `rgb(${INKS[(code - 1) % INKS.length].join(" ")})`;
      item.className = "nowrap";
      item.prepend(key);
      legend.append(item, " ");
    }
    if (!legend.childNodes.length) legend.textContent = "All of this section is measured.";
    $("told").append(legend);
  }
  $("told").append(link);
  $("section-said").textContent = `${s.name}, ${k + 1} of ${N}`;
  $("density-said").textContent = +field("density") ? field("density") + " %" : "off";
  $("size-said").textContent = "× " + (field("size") / 10).toFixed(1);
}
function go(to) {
  k = Math.max(0, Math.min(N - 1, to));
  turn = 0;
  $("section").value = k;
  if (decodeURIComponent(location.hash) !== "#section-" + sections[k].serial)
    history.replaceState(null, "", "#section-" + sections[k].serial);
  tell();
  later();
}
/* By the address: another section may be asked for while the page is open. At first the middle one of
 * those with a density, which are in the region. */
function goToAddress() {
  const i = sections.findIndex(s => "#section-" + s.serial === location.hash);
  const dense = [...sections.keys()].filter(at => sections[at].density);
  go(i >= 0 ? i : dense.length ? dense[dense.length >> 1] : N >> 1);
}
/* The middle of what is seen stays where it is. */
function resize() {
  const w = stage.clientWidth, x = (stage.scrollLeft + w / 2) / (view.clientWidth || w);
  const y = (stage.scrollTop + stage.clientHeight / 2) / (view.clientHeight || stage.clientHeight);
  const shown = Math.round(Math.min(w, stage.clientHeight) * field("size") / 10);
  view.style.width = view.style.height = shown + "px";
  view.width = view.height = Math.min(4096, shown * ratio());
  stage.scrollLeft = x * shown - w / 2;
  stage.scrollTop = y * shown - stage.clientHeight / 2;
  drawScale();
  later();
}

/* ---- hands ---- */

setInterval(() => {
  if (field("with") === "0" || document.hidden) return;
  turn = 1 - turn;
  later();
}, 450);
function zoom(by) {
  $("size").value = Math.round(field("size") * by);
  resize();
}
function home() {
  for (const [name, value] of [["density", 0], ["with", "0"], ["size", 10]]) $(name).value = value;
  for (const [name, on] of [["marks", true], ["masked", false], ["region", true]])
    $(name).checked = on;
  turn = 0;
  resize();
  tell();
}
const pointers = new Map();
stage.addEventListener("pointerdown", e => {
  if (e.pointerType !== "mouse") return; /* fingers scroll by themselves */
  pointers.set(e.pointerId, [e.clientX, e.clientY]);
  stage.setPointerCapture(e.pointerId);
});
stage.addEventListener("pointermove", e => {
  const was = pointers.get(e.pointerId), box = view.getBoundingClientRect();
  place = [corner[0] + (e.clientX - box.left) / box.width * wideUm,
           corner[1] + (e.clientY - box.top) / box.height * wideUm];
  if (place.some((v, c) => v < corner[c] || v >= corner[c] + wideUm)) place = null;
  if (was) {
    stage.scrollLeft -= e.clientX - was[0];
    stage.scrollTop -= e.clientY - was[1];
    pointers.set(e.pointerId, [e.clientX, e.clientY]);
  }
  tell();
});
for (const name of ["pointerup", "pointercancel"])
  stage.addEventListener(name, e => pointers.delete(e.pointerId));
stage.addEventListener("wheel", e => {
  if (!e.ctrlKey && document.activeElement !== view) return;
  e.preventDefault();
  zoom(Math.exp(-e.deltaY / 500));
}, { passive: false });
view.addEventListener("keydown", e => {
  const flip = name => { $(name).checked = !tick(name); tell(); later(); };
  const set = (name, value) => { $(name).value = value; turn = 0; tell(); later(); };
  const keys = {
    ArrowLeft: () => go(k - 1), ArrowUp: () => go(k - 1),
    ArrowRight: () => go(k + 1), ArrowDown: () => go(k + 1), Home: () => go(0), End: () => go(N - 1),
    "+": () => zoom(1.3), "=": () => zoom(1.3), "-": () => zoom(1 / 1.3), "0": home,
    f: () => set("with", field("with") === "0" ? "1" : "0"),
    d: () => set("density", +field("density") ? 0 : 70), m: () => flip("masked"),
  };
  if (!keys[e.key] || e.ctrlKey || e.metaKey || e.altKey) return;
  e.preventDefault();
  keys[e.key]();
});
$("section").addEventListener("input", () => go(+field("section")));
$("back").addEventListener("click", () => go(k - 1));
$("on").addEventListener("click", () => go(k + 1));
$("home").addEventListener("click", home);
$("size").addEventListener("input", resize);
for (const name of ["marks", "masked", "region", "density", "with"])
  $(name).addEventListener("input", () => { turn = 0; tell(); later(); });

$("section").max = N - 1;
root.hidden = false;
$("row").hidden = true;
goToAddress();
resize();
window.addEventListener("hashchange", goToAddress);
new ResizeObserver(resize).observe(stage);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", resize);
})();
