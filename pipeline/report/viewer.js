/* The model in three dimensions. Draws what lies between two densities, closed where the region or
 * a plane ends it, or seen through, or every cell by itself; a click asks a cell. Reads the format of
 * pipeline/export/page_model.h; micrometres of the block frame, y and z as in the cuts. */
"use strict";
(async () => {
const $ = id => document.getElementById("viewer-" + id);
const root = document.getElementById("viewer"), view = $("model");
/* A processor that draws in a card's stead is spared what smooths the edges. */
function drawsInSoftware() {
  const probe = document.createElement("canvas").getContext("webgl2");
  const about = probe && probe.getExtension("WEBGL_debug_renderer_info");
  return about && /swiftshader|llvmpipe|software/i.test(
    probe.getParameter(about.UNMASKED_RENDERER_WEBGL));
}
const gl = view.getContext("webgl2", { antialias: !drawsInSoftware(), alpha: true });
if (!gl || !window.DecompressionStream) return;

/* ---- the model ---- */

const packed = Uint8Array.from(atob($("data").textContent), c => c.charCodeAt(0));
const plain = await new Response(new Blob([packed]).stream()
  .pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
const bytes = new Uint8Array(plain), UNKNOWN = -(2 ** 31);
const [V, E, C, ox, oy, oz, sx, sy, sz, sLow, sStep, digits, volumeDigits, low, high, channels] =
  new Float64Array(plain, 0, 16);
let read = 16 * 8;
function column(n) {
  const width = bytes[read++], out = new Int32Array(n);
  for (let i = 0, last = 0; i < n; i++) {
    let v = 0;
    for (let b = 0; b < width; b++) v |= bytes[read + b * n + i] << 8 * b;
    out[i] = last = last + ((v >>> 1) ^ -(v & 1)) | 0;
  }
  read += width * n;
  return out;
}
const xyz = [column(V), column(V), column(V)], from = [ox, oy, oz], step = [sx, sy, sz];
const corners = [column(C), column(C), column(C), column(C)];
const N = V + E, s = new Float32Array(N), at = new Float32Array(3 * N);
for (const [first, n] of [[0, V], [V, E]]) column(n).forEach((v, i) => s[first + i] = sLow + sStep * v);
const cell = {};
for (const name of ["number", "density", "lower", "upper", "residual", "below", "above", "samples",
                    "share", "volume"]) cell[name] = column(C);
const inward = new Float32Array(N);
for (const [first, n] of [[0, V], [V, E]]) inward.set(column(n), first);
/* Light from codes of sRGB: what lies between two nodes is a mixture of their light. */
const light = new Float32Array(3 * N);
for (let c = 0; c < channels; c++)
  for (const [first, n] of [[0, V], [V, E]]) column(n).forEach((v, i) => {
    v /= 255;
    light[3 * (first + i) + c] = v <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4;
  });
const unit = 10 ** digits, least = [0, 1, 2].map(() => Infinity), most = least.map(v => -v);
for (let v = 0; v < V; v++)
  for (let c = 0; c < 3; c++) {
    const place = at[3 * v + c] = from[c] + xyz[c][v] * step[c];
    if (inward[v] < -40) continue;
    least[c] = Math.min(least[c], place);
    most[c] = Math.max(most[c], place);
  }
/* The box around what is shown; places are counted from its middle. */
const origin = least, extent = most.map((v, c) => v - least[c]);
const middle = origin.map((o, c) => o + extent[c] / 2), radius = Math.hypot(...extent) / 2;
for (let k = 0; k < 3 * V; k++) at[k] -= middle[k % 3];

/* Ten nodes a cell: corners, then the middles of its edges. */
const PAIRS = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];
const PARTS = [[0, 4, 5, 6], [1, 4, 7, 8], [2, 5, 7, 9], [3, 6, 8, 9],
               [5, 8, 4, 7], [5, 8, 7, 9], [5, 8, 9, 6], [5, 8, 6, 4]];
const FACES = [[1, 2, 3, 7, 9, 8], [0, 3, 2, 6, 9, 5], [0, 1, 3, 4, 8, 6], [0, 2, 1, 5, 7, 4]];
const node = new Uint32Array(10 * C), ends = [];
{
  const edges = new Map(), faces = new Map();
  for (let i = 0; i < C; i++) {
    const own = corners.map(c => c[i]);
    node.set(own, 10 * i);
    PAIRS.forEach(([p, q], k) => {
      const a = Math.min(own[p], own[q]), b = Math.max(own[p], own[q]), key = a * V + b;
      let e = edges.get(key);
      if (e === undefined) {
        edges.set(key, e = V + edges.size);
        for (let c = 0; c < 3; c++) at[3 * e + c] = (at[3 * a + c] + at[3 * b + c]) / 2;
      }
      node[10 * i + 4 + k] = e;
    });
    FACES.forEach((face, k) => {
      const [a, b, c] = face.slice(0, 3).map(f => own[f]).sort((p, q) => p - q);
      const key = (a * V + b) * V + c;
      if (!faces.delete(key)) faces.set(key, 4 * i + k);
    });
  }
  ends.push(...[...faces.values()].sort((p, q) => p - q));
}
/* Slopes at the nodes, for the light on a surface: means over the parts around. */
function slopes(f) {
  const slope = new Float32Array(3 * N);
  for (let i = 0; i < C; i++) for (const part of PARTS) {
    const n = part.map(k => node[10 * i + k]), d = [1, 2, 3].map(k =>
      [0, 1, 2].map(c => at[3 * n[k] + c] - at[3 * n[0] + c]));
    const x = [cross(d[1], d[2]), cross(d[2], d[0]), cross(d[0], d[1])];
    const sign = Math.sign(dot(d[0], x[0]));
    for (let c = 0; c < 3; c++) {
      const g = sign * [0, 1, 2].reduce((sum, k) => sum + (f[n[k + 1]] - f[n[0]]) * x[k][c], 0);
      for (const k of n) slope[3 * k + c] += g;
    }
  }
  return slope;
}
function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}
function dot(a, b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* ---- the graphics card ---- */

const MAP = [68, 1, 84, 72, 24, 106, 71, 45, 123, 66, 64, 134, 59, 82, 139, 51, 99, 141, 44, 114,
  142, 38, 130, 142, 33, 145, 140, 31, 160, 136, 40, 174, 128, 63, 188, 115, 94, 201, 98, 132, 212,
  75, 173, 220, 48, 216, 226, 25, 253, 231, 37]; /* viridis */
const VERTEX = `#version 300 es
in vec3 a_at, a_mid, a_normal, a_colour;
in float a_s, a_density, a_inward;
uniform mat3 u_turn;
uniform vec4 u_frame, u_cut;
uniform vec2 u_range;
uniform float u_shrink, u_depth;
out vec3 v_at, v_eye, v_normal, v_colour;
out float v_s, v_density, v_inward;
void main() {
  v_inward = a_inward;
  v_colour = a_colour;
  v_at = mix(a_mid, a_at, u_shrink);
  v_eye = u_turn * v_at;
  v_normal = u_turn * a_normal;
  v_s = a_s;
  v_density = a_density;
  gl_Position = vec4(v_eye.xy * u_frame.xy + u_frame.zw, -v_eye.z * u_depth, 1);
  if (u_shrink < 1. && (dot(a_mid, u_cut.xyz) > u_cut.w || a_density < u_range.x ||
      a_density > u_range.y)) gl_Position = vec4(2, 2, 2, 1);
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 v_at, v_eye, v_normal, v_colour;
in float v_s, v_density, v_inward;
uniform vec3 u_map[17];
uniform vec4 u_cut;
uniform vec2 u_range, u_ends;
uniform float u_shrink;
uniform int u_light, u_cells, u_pick, u_true;
out vec4 colour;
void main() {
  if (u_shrink == 1.) {
    if (u_light != 2 && dot(v_at, u_cut.xyz) > u_cut.w) discard;
    if (v_inward < -.01) discard;
    if (u_light != 1 && (v_s < u_range.x || v_s > u_range.y)) discard;
  }
  if (u_pick == 1) {
    vec3 z = fract(gl_FragCoord.z * vec3(1, 255, 65025));
    colour = vec4(z - z.yzz * vec3(1. / 255., 1. / 255., 0), 1);
    return;
  }
  float t = 16. * clamp(((u_cells == 1 ? v_density : v_s) - u_ends.x) / (u_ends.y - u_ends.x), 0., 1.);
  int i = int(min(t, 15.));
  vec3 c = u_true == 1 ? v_colour : mix(u_map[i], u_map[i + 1], t - float(i));
  if (u_light != 2) {
    vec3 n = normalize(u_light != 0 ? v_normal : cross(dFdx(v_eye), dFdy(v_eye)));
    c *= .45 + .55 * abs(dot(n, normalize(vec3(-.3, .35, 1))));
  }
  if (u_true == 1) c = mix(12.92 * c, 1.055 * pow(c, vec3(1. / 2.4)) - .055, step(.0031308, c));
  colour = vec4(c, 1);
}`;
/* Emission and absorption along each ray, from the eye on (Max 1995): opacity grows with density
 * as the slider says; of a voxel the texture has density and colour times how much of it is known. */
const THROUGH_VERTEX = `#version 300 es
out vec2 v_clip;
void main() {
  v_clip = vec2(gl_VertexID == 1 ? 3. : -1., gl_VertexID == 2 ? 3. : -1.);
  gl_Position = vec4(v_clip, 0, 1);
}`;
const THROUGH = `#version 300 es
precision highp float;
precision highp sampler3D;
in vec2 v_clip;
uniform sampler3D u_density, u_colour;
uniform vec3 u_map[17], u_extent;
uniform mat3 u_turn;
uniform vec4 u_frame, u_cut;
uniform vec2 u_range;
uniform float u_thick, u_step;
uniform int u_true;
out vec4 colour;
void main() {
  vec3 from = vec3((v_clip - u_frame.zw) / u_frame.xy, 0) * u_turn, way = -vec3(0, 0, 1) * u_turn;
  vec3 safe = way + vec3(equal(way, vec3(0))) * 1e-9;
  vec3 a = (-.5 * u_extent - from) / safe, b = (.5 * u_extent - from) / safe;
  vec3 least = min(a, b), most = max(a, b);
  float t = max(max(least.x, least.y), least.z), end = min(min(most.x, most.y), most.z);
  float along = dot(way, u_cut.xyz), left = u_cut.w - dot(from, u_cut.xyz);
  if (along > 1e-9) end = min(end, left / along);
  else if (along < -1e-9) t = max(t, left / along);
  else if (left < 0.) end = t;
  colour = vec4(0);
  t += u_step * fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(.06711056, .00583715))));
  for (int n = 0; n < 400 && t < end && colour.a < .99; n++, t += u_step) {
    vec3 p = (from + t * way) / u_extent + .5;
    vec2 got = texture(u_density, p).rg;
    if (got.g < .02) continue;
    float s = got.r / got.g;
    if (s < u_range.x || s > u_range.y) continue;
    float share = 1. - exp(-u_thick * s * got.g * u_step);
    int i = int(min(16. * s, 15.));
    vec3 c = u_true == 1 ? texture(u_colour, p).rgb / got.g
      : mix(u_map[i], u_map[i + 1], 16. * s - float(i));
    colour += (1. - colour.a) * share * vec4(c, 1);
  }
}`;
function programOf(vertex, fragment, names) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  ["a_at", "a_normal", "a_s", "a_density", "a_inward", "a_mid", "a_colour"].forEach((name, i) =>
    gl.bindAttribLocation(made, i, name));
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) return null;
  gl.useProgram(made);
  const uniform = Object.fromEntries(names.map(name =>
    [name, gl.getUniformLocation(made, "u_" + name)]));
  gl.uniform3fv(uniform.map, MAP.map(v => v / 255));
  return { made, uniform };
}
const solid = programOf(VERTEX, FRAGMENT, ["map", "turn", "frame", "cut", "range", "ends", "shrink",
  "depth", "light", "cells", "pick", "true"]);
if (!solid) return;
const uniform = solid.uniform;
gl.uniform2f(uniform.ends, low, high);
gl.uniform1f(uniform.depth, .5 / radius);
gl.enable(gl.DEPTH_TEST);

/* Triangles whose vertices are twelve numbers: place, normal, s, density of the cell, way inward,
 * light.
 * light: 0 by the triangle, 1 by the slope, on a level, 2 none, on a cut, 3 by the slope. */
class Mesh {
  constructor(light, slope) {
    this.light = light;
    this.slope = slope || new Float32Array(3 * N);
    this.room = new Float32Array(12 * 3072);
    this.used = 0;
    this.vao = gl.createVertexArray();
    this.buffer = gl.createBuffer();
    gl.bindVertexArray(this.vao);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    [[0, 3, 0], [1, 3, 12], [2, 1, 24], [3, 1, 28], [4, 1, 32], [6, 3, 36]].forEach(
      ([i, n, first]) => {
        gl.enableVertexAttribArray(i);
        gl.vertexAttribPointer(i, n, gl.FLOAT, false, 48, first);
      });
  }
  /* A point on the way t from node a to node b. */
  add(a, b, t, density) {
    if (this.used + 12 > this.room.length) {
      const grown = new Float32Array(2 * this.room.length);
      grown.set(this.room);
      this.room = grown;
    }
    const o = this.room, k = this.used, g = this.slope;
    for (let c = 0; c < 3; c++) {
      o[k + c] = at[3 * a + c] + t * (at[3 * b + c] - at[3 * a + c]);
      o[k + 3 + c] = g[3 * a + c] + t * (g[3 * b + c] - g[3 * a + c]);
      o[k + 9 + c] = light[3 * a + c] + t * (light[3 * b + c] - light[3 * a + c]);
    }
    o[k + 6] = s[a] + t * (s[b] - s[a]);
    o[k + 7] = density;
    o[k + 8] = inward[a] + t * (inward[b] - inward[a]);
    this.used += 12;
  }
  /* Where f, given at the nodes, is 0 in every part of every cell: marching tetrahedra. */
  march(f) {
    const end = [0, 0, 0, 0];
    for (let i = 0; i < C; i++) {
      let least = Infinity, most = -Infinity;
      for (let k = 10 * i; k < 10 * i + 10; k++) {
        const v = f[node[k]];
        if (v < least) least = v;
        if (v > most) most = v;
      }
      if (least >= 0 || most < 0) continue;
      const density = cell.density[i] / unit;
      for (const part of PARTS) {
        let inside = 0;
        for (let k = 0, o = 3; k < 4; k++) {
          const n = node[10 * i + part[k]];
          if (f[n] >= 0) end[inside++] = n; else end[o--] = n;
        }
        if (inside === 0 || inside === 4) continue;
        const way = inside === 1 ? [0, 1, 0, 2, 0, 3] : inside === 3 ? [0, 3, 1, 3, 2, 3]
          : [0, 2, 0, 3, 1, 3, 0, 2, 1, 3, 1, 2];
        for (let k = 0; k < way.length; k += 2) {
          const a = end[way[k]], b = end[way[k + 1]];
          this.add(a, b, f[a] / (f[a] - f[b]), density);
        }
      }
    }
  }
  send() {
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, this.room.subarray(0, this.used), gl.DYNAMIC_DRAW);
  }
  draw() {
    if (!this.used) return;
    gl.uniform1i(uniform.light, this.light);
    gl.bindVertexArray(this.vao);
    gl.drawArrays(gl.TRIANGLES, 0, this.used / 12);
  }
}
const steep = slopes(s), walls = [new Mesh(1, steep), new Mesh(1, steep)], cap = new Mesh(2);
const border = new Mesh(3, slopes(inward)), skin = new Mesh(0);
border.march(inward);
border.send();
for (const f of ends) {
  const i = f >> 2, around = FACES[f & 3].map(k => node[10 * i + k]), [a, b, c, d, e, g] = around;
  if (around.some(n => inward[n] >= 0))
    for (const n of [a, d, g, d, b, e, g, e, c, d, e, g]) skin.add(n, n, 0, cell.density[i] / unit);
}
skin.send();

/* All cells, each with corners of its own, made when they are first shown apart. */
let apart;
function makeApart() {
  const room = new Float32Array(4 * 12 * C), order = new Uint32Array(12 * C);
  for (let i = 0; i < C; i++) {
    const mid = centre(i);
    for (let k = 0; k < 4; k++) {
      const n = node[10 * i + k], o = 12 * (4 * i + k);
      for (let c = 0; c < 3; c++) {
        room[o + c] = at[3 * n + c];
        room[o + 3 + c] = light[3 * n + c];
        room[o + 8 + c] = mid[c];
      }
      room[o + 6] = room[o + 7] = cell.density[i] / unit;
    }
    FACES.forEach((f, k) => order.set([f[0], f[1], f[2]].map(v => 4 * i + v), 12 * i + 3 * k));
  }
  const vao = gl.createVertexArray();
  gl.bindVertexArray(vao);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, room, gl.STATIC_DRAW);
  [[0, 3, 0], [2, 1, 24], [3, 1, 28], [5, 3, 32], [6, 3, 12]].forEach(([i, n, first]) => {
    gl.enableVertexAttribArray(i);
    gl.vertexAttribPointer(i, n, gl.FLOAT, false, 48, first);
  });
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, order, gl.STATIC_DRAW);
  return vao;
}
function centre(i) {
  return [0, 1, 2].map(c =>
    (at[3 * node[10 * i] + c] + at[3 * node[10 * i + 1] + c] + at[3 * node[10 * i + 2] + c] +
     at[3 * node[10 * i + 3] + c]) / 4);
}

/* What is seen through, made when it first is: a voxel has the value at its middle of what is linear
 * in each part of each cell. Codes of colour, as the eye has them. */
let through;
function voxelsOf(most) {
  const edge = Math.max(...extent) / most, n = extent.map(e => Math.max(1, Math.ceil(e / edge)));
  const wide = extent.map((e, c) => e / n[c]), known = new Uint8Array(2 * n[0] * n[1] * n[2]);
  const colour = channels ? new Uint8Array(3 * n[0] * n[1] * n[2]) : null;
  const code = v => 255 * (v <= .0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - .055);
  for (let i = 0; i < C; i++) for (const part of PARTS) {
    const own = part.map(k => node[10 * i + k]), p = own.map(k => [...at.subarray(3 * k, 3 * k + 3)]);
    const d = [1, 2, 3].map(k => p[k].map((v, c) => v - p[0][c]));
    const x = [cross(d[1], d[2]), cross(d[2], d[0]), cross(d[0], d[1])], volume = dot(d[0], x[0]);
    const [least, most] = [Math.min, Math.max].map(end => [0, 1, 2].map(c =>
      (end(p[0][c], p[1][c], p[2][c], p[3][c]) + extent[c] / 2) / wide[c] - .5));
    if (Math.abs(volume) < 1e-9) continue;
    for (let w = Math.max(0, Math.ceil(least[2])); w <= Math.min(n[2] - 1, most[2]); w++)
      for (let v = Math.max(0, Math.ceil(least[1])); v <= Math.min(n[1] - 1, most[1]); v++)
        for (let u = Math.max(0, Math.ceil(least[0])); u <= Math.min(n[0] - 1, most[0]); u++) {
          const q = [u, v, w].map((k, c) => (k + .5) * wide[c] - extent[c] / 2 - p[0][c]);
          const share = [0, dot(q, x[0]) / volume, dot(q, x[1]) / volume, dot(q, x[2]) / volume];
          share[0] = 1 - share[1] - share[2] - share[3];
          if (Math.min(...share) < -1e-6) continue;
          const mean = f => share.reduce((sum, a, k) => sum + a * f(own[k]), 0);
          if (mean(k => inward[k]) < 0) continue;
          const o = (w * n[1] + v) * n[0] + u;
          known[2 * o] = Math.round(255 * Math.min(1, Math.max(0, (mean(k => s[k]) - low) / (high - low))));
          known[2 * o + 1] = 255;
          for (let c = 0; colour && c < 3; c++)
            colour[3 * o + c] = Math.round(code(mean(k => light[3 * k + c])));
        }
  }
  return { n, edge, known, colour };
}
function makeThrough() {
  const program = programOf(THROUGH_VERTEX, THROUGH, ["map", "density", "colour", "extent", "turn",
    "frame", "cut", "range", "thick", "step", "true"]);
  const made = program && { ...program, ...voxelsOf(112) };
  if (!made) return null;
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  [[made.known, gl.RG8, gl.RG], [made.colour || new Uint8Array(made.n[0] * made.n[1] * made.n[2] * 3),
    gl.RGB8, gl.RGB]].forEach(([bytes, kept, format], i) => {
    gl.activeTexture(gl.TEXTURE0 + i);
    gl.bindTexture(gl.TEXTURE_3D, gl.createTexture());
    gl.texImage3D(gl.TEXTURE_3D, 0, kept, ...made.n, 0, format, gl.UNSIGNED_BYTE, bytes);
    for (const name of ["MIN_FILTER", "MAG_FILTER"])
      gl.texParameteri(gl.TEXTURE_3D, gl["TEXTURE_" + name], gl.LINEAR);
    for (const axis of "STR")
      gl.texParameteri(gl.TEXTURE_3D, gl["TEXTURE_WRAP_" + axis], gl.CLAMP_TO_EDGE);
  });
  gl.uniform1i(made.uniform.density, 0);
  gl.uniform1i(made.uniform.colour, 1);
  gl.uniform3fv(made.uniform.extent, extent);
  gl.uniform1f(made.uniform.step, .7 * made.edge);
  made.vao = gl.createVertexArray();
  return made;
}
function renderThrough() {
  through ||= makeThrough();
  if (!through) return;
  const of = through.uniform, ends = range.map(v => (v - low) / (high - low));
  gl.useProgram(through.made);
  place(of);
  gl.uniform2f(of.range, ends[0] < 0 ? -1 : ends[0], ends[1] > 1 ? 2 : ends[1]);
  gl.uniform1f(of.thick, -Math.log(1 - field("opacity") / 100) / (.2 * radius));
  gl.uniform1i(of.true, isTrue() ? 1 : 0);
  gl.bindVertexArray(through.vao);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
}

/* ---- what is shown ---- */

const HOME = { azimuth: -.62, elevation: .5, zoom: 1, x: 0, y: 0 };
const eye = { ...HOME };
let turn = [], cut = [0, 0, 0, 1], range = [-Infinity, Infinity], chosen = -1, due = 0, coarse = 1;
const field = name => $(name).value;
const shrunk = () => +field("shrink") / 100;
/* A tenth of the model's width at the highest density hides as much as the slider says. */
const isThrough = () => +field("opacity") < 100 && shrunk() === 1;
const isTrue = () => channels > 0 && $("true").checked;
function lookAround() {
  const [sa, ca, se, ce] = [Math.sin(eye.azimuth), Math.cos(eye.azimuth), Math.sin(eye.elevation),
                            Math.cos(eye.elevation)];
  turn = [[ca, sa, 0], [sa * se, -ca * se, -ce], [-sa * ce, ca * ce, -se]];
}
/* Keeps the side of the plane that is not seen through it: dot(place, normal) <= distance. */
function setCut() {
  const way = field("cut"), across = "xyz".indexOf(way);
  const normal = way === "none" ? [0, 0, 0] : across < 0 ? [...turn[2]]
    : [0, 1, 2].map(c => c === across ? (turn[2][c] < 0 ? -1 : 1) : 0);
  const reach = way === "none" ? 0 : across < 0 ? radius : extent[across] / 2;
  const share = +field("place") / 500 - 1; /* -1..1 along the axis, or towards the eye */
  const along = across < 0 ? 1 : normal[across];
  cut = [...normal, way === "none" ? 1 : share * reach * along];
  $("place").disabled = way === "none";
  $("place-said").textContent =
    across < 0 ? "" : `${way} ${Math.round(middle[across] + share * reach)} µm`.replace("-", "−");
  cap.used = 0;
  if (way !== "none" && shrunk() === 1) {
    const f = new Float32Array(N);
    for (let n = 0; n < N; n++)
      f[n] = at[3 * n] * cut[0] + at[3 * n + 1] * cut[1] + at[3 * n + 2] * cut[2] - cut[3];
    cap.march(f);
  }
  cap.send();
}
/* The ends of the sliders are no limits: the model goes beyond the colours. */
function setRange() {
  const ends = ["from", "to"].map(name => +field(name));
  range = [ends[0] <= 0 ? -1e30 : low + ends[0] / 1000 * (high - low),
           ends[1] >= 1000 ? 1e30 : low + ends[1] / 1000 * (high - low)];
  ["from", "to"].forEach((name, k) => {
    $(name + "-said").textContent = Math.abs(range[k]) > 1e29 ? "all" : said(range[k]);
    walls[k].used = 0;
    if (Math.abs(range[k]) < 1e29 && shrunk() === 1) walls[k].march(s.map(v => v - range[k]));
    walls[k].send();
  });
  drawScale();
  tell();
}
const said = v => v.toFixed(Math.max(0, digits - 2));
function setShrink() {
  $("shrink-said").textContent = shrunk() === 1 ? "whole" : field("shrink") + " %";
  $("smooth").disabled = shrunk() < 1 || isThrough();
  $("opacity").disabled = shrunk() < 1;
  $("opacity-said").textContent = +field("opacity") < 100 ? field("opacity") + " %" : "solid";
  setRange();
  setCut();
}

/* ---- drawing ---- */

let wide = 0, tall = 0, ratio = 1, fill = 1, drawn = "";
/* Pixels of the screen a micrometre. */
const scale = () => fill * eye.zoom;
function toScreen(p) {
  return [wide / 2 + eye.x + scale() * dot(p, turn[0]), tall / 2 + eye.y - scale() * dot(p, turn[1])];
}
function place(of) {
  gl.uniformMatrix3fv(of.turn, true, turn.flat());
  gl.uniform4f(of.frame, 2 * scale() / wide, 2 * scale() / tall, 2 * eye.x / wide, -2 * eye.y / tall);
  gl.uniform4fv(of.cut, cut);
}
function render(pick) {
  gl.viewport(0, 0, view.width, view.height);
  gl.clearColor(pick, pick, pick, pick);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  if (!pick && isThrough()) {
    renderThrough();
    return;
  }
  gl.useProgram(solid.made);
  gl.uniform1i(uniform.pick, pick);
  gl.uniform1i(uniform.true, isTrue() ? 1 : 0);
  gl.uniform1i(uniform.cells, shrunk() < 1 || !$("smooth").checked ? 1 : 0);
  place(uniform);
  gl.uniform2fv(uniform.range, range);
  gl.uniform1f(uniform.shrink, shrunk());
  if (shrunk() < 1) {
    apart ||= makeApart();
    gl.enable(gl.CULL_FACE);
    gl.uniform1i(uniform.light, 0);
    gl.bindVertexArray(apart);
    gl.drawElements(gl.TRIANGLES, 12 * C, gl.UNSIGNED_INT, 0);
    gl.disable(gl.CULL_FACE);
  } else {
    for (const mesh of [border, skin, ...walls, cap]) mesh.draw();
  }
}
/* A canvas of text and lines, as large as its box, cleared. */
function pen(canvas) {
  const w = canvas.clientWidth, h = canvas.clientHeight, style = getComputedStyle(root);
  if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
    canvas.width = Math.round(w * ratio);
    canvas.height = Math.round(h * ratio);
  }
  const to = canvas.getContext("2d");
  to.setTransform(ratio, 0, 0, ratio, 0, 0);
  to.clearRect(0, 0, w, h);
  to.font = `12px ${style.fontFamily}`;
  to.ink = style.getPropertyValue("--ink");
  to.soft = style.getPropertyValue("--soft");
  to.fillStyle = to.soft;
  to.strokeStyle = style.getPropertyValue("--soft");
  return to;
}
function line(to, a, b) {
  to.beginPath();
  to.moveTo(...a);
  to.lineTo(...b);
  to.stroke();
}
const round = most => {
  const ten = 10 ** Math.floor(Math.log10(most));
  return ten * (most >= 5 * ten ? 5 : most >= 2 * ten ? 2 : 1);
};
const roundUp = least => {
  const ten = 10 ** Math.floor(Math.log10(least) + 1e-9);
  return ten * (least > 5 * ten ? 10 : least > 2 * ten ? 5 : least > ten ? 2 : 1);
};
/* The box around the model: edges behind it in the lower canvas, an axis each on the outline. */
function drawBox() {
  const back = pen($("back")), front = pen($("front"));
  const corner = bits => extent.map((e, c) => bits >> c & 1 ? e / 2 : -e / 2);
  back.strokeStyle = getComputedStyle(root).getPropertyValue("--line");
  for (let a = 0; a < 3; a++) {
    const [b, c] = [(a + 1) % 3, (a + 2) % 3];
    let best, lowest = -Infinity;
    for (let k = 0; k < 4; k++) {
      const bits = (k & 1) << b | (k >> 1) << c, p = corner(bits), q = corner(bits | 1 << a);
      const facing = [k & 1 ? turn[2][b] : -turn[2][b], k >> 1 ? turn[2][c] : -turn[2][c]];
      if (facing[0] <= 0 || facing[1] <= 0) line(back, toScreen(p), toScreen(q));
      const [m, n] = [toScreen(p), toScreen(q)];
      const rank = a === 2 ? -(m[0] + n[0]) : m[1] + n[1];
      if (facing[0] * facing[1] <= 0 && rank > lowest) [best, lowest] = [[p, q], rank];
    }
    if (best) drawAxis(front, a, ...best);
  }
  drawBar(front);
  if (chosen >= 0) drawChosen(front);
}
function drawAxis(to, a, p, q) {
  const [m, n] = [toScreen(p), toScreen(q)], long = Math.hypot(n[0] - m[0], n[1] - m[1]);
  if (long < 40) return;
  const every = roundUp(extent[a] * (a === 2 ? 32 : 48) / long), out = [m[1] - n[1], n[0] - m[0]];
  const mid = [(m[0] + n[0]) / 2, (m[1] + n[1]) / 2];
  const to0 = toScreen([0, 0, 0]);
  const sign = (mid[0] - to0[0]) * out[0] + (mid[1] - to0[1]) * out[1] < 0 ? -1 : 1;
  const off = out.map(v => sign * v / long);
  line(to, m, n);
  to.textAlign = off[0] < -.5 ? "right" : off[0] > .5 ? "left" : "center";
  to.textBaseline = "middle";
  for (let v = Math.ceil(origin[a] / every) * every; v <= origin[a] + extent[a]; v += every) {
    const t = (v - origin[a]) / extent[a], at0 = m.map((x, c) => x + t * (n[c] - x));
    line(to, at0, at0.map((x, c) => x + 4 * off[c]));
    to.fillText(String(v).replace("-", "−"), at0[0] + 9 * off[0], at0[1] + 12 * off[1]);
  }
  to.fillStyle = to.ink;
  if (a === 2) {
    const top = m[1] < n[1] ? m : n;
    to.textAlign = "center";
    to.fillText("z µm", top[0], top[1] - 12);
  } else {
    to.fillText("xyz"[a] + " µm", mid[0] + 44 * off[0], mid[1] + 30 * off[1]);
  }
  to.fillStyle = to.soft;
}
function drawBar(to) {
  const um = round(.25 * wide / scale()), long = um * scale();
  to.fillStyle = to.ink;
  to.fillRect(12, tall - 12, long, 3);
  to.textAlign = "left";
  to.textBaseline = "bottom";
  to.fillText(um >= 1000 ? um / 1000 + " mm" : um + " µm", 12, tall - 15);
  to.fillStyle = to.soft;
}
function drawChosen(to) {
  const mid = centre(chosen), ends = [0, 1, 2, 3].map(k => toScreen(mid.map((m, c) =>
    m + Math.min(1, shrunk()) * (at[3 * node[10 * chosen + k] + c] - m))));
  for (const [colour, width] of [["#fff", 4], ["#d0006f", 2]]) {
    to.strokeStyle = colour;
    to.lineWidth = width;
    to.lineJoin = "round";
    to.beginPath();
    for (const [p, q] of PAIRS) {
      to.moveTo(...ends[p]);
      to.lineTo(...ends[q]);
    }
    to.stroke();
  }
  to.lineWidth = 1;
}
function drawScale() {
  const to = pen($("scale")), w = $("scale").clientWidth, x0 = 14, long = w - 28;
  if (isTrue()) {
    to.fillStyle = to.ink;
    to.textAlign = "left";
    to.textBaseline = "top";
    to.fillText("true colour, as the sections look", x0, 2);
    return;
  }
  for (let x = 0; x < long; x++) {
    const t = 16 * x / long, i = Math.min(15, Math.floor(t));
    to.fillStyle = `rgb(${[0, 1, 2].map(c =>
      Math.round(MAP[3 * i + c] + (t - i) * (MAP[3 * i + 3 + c] - MAP[3 * i + c])))})`;
    to.fillRect(x0 + x, 20, 1.5, 12);
  }
  const every = roundUp((high - low) * 50 / long);
  to.fillStyle = to.ink;
  to.textAlign = "left";
  to.textBaseline = "top";
  to.fillText(root.dataset.unit + (shrunk() < 1 || !$("smooth").checked && !isThrough()
    ? ", mean of each cell" : ""), x0, 2);
  to.textAlign = "center";
  for (let k = Math.ceil(low / every - 1e-9); k * every <= high + 1e-9 * every; k++) {
    const x = x0 + long * (k * every - low) / (high - low);
    line(to, [x, 32], [x, 36]);
    to.fillText(+(k * every).toPrecision(6), x, 38);
  }
  to.globalAlpha = .8;
  to.fillStyle = getComputedStyle(root).getPropertyValue("--card");
  const [a, b] = range.map(v => x0 + long * Math.min(1, Math.max(0, (v - low) / (high - low))));
  to.fillRect(x0, 20, a - x0, 12);
  to.fillRect(b, 20, x0 + long - b, 12);
  to.globalAlpha = 1;
}
function draw() {
  due = 0;
  const w = Math.round(wide * ratio / coarse), h = Math.round(tall * ratio / coarse);
  if (view.width !== w || view.height !== h) {
    view.width = w;
    view.height = h;
  }
  render(0);
  /* Lines and letters change with the view alone. */
  const shown = JSON.stringify([eye, chosen, chosen < 0 || shrunk()]);
  if (shown !== drawn) drawBox();
  drawn = shown;
  root.dataset.drawn = +(root.dataset.drawn || 0) + 1;
}
function later() { due ||= requestAnimationFrame(draw); }
/* As large as fits with room for the axes, turned as at first or any other way around z. */
function resize() {
  const flat = Math.hypot(extent[0], extent[1]), lean = Math.sin(HOME.elevation);
  ratio = Math.min(2, devicePixelRatio || 1);
  wide = view.clientWidth;
  tall = view.clientHeight;
  fill = Math.min((wide - 130) / flat,
                  (tall - 130) / (flat * lean + extent[2] * Math.cos(HOME.elevation)));
  drawn = "";
  drawScale();
  later();
}

/* ---- asking a cell ---- */

/* The place on what is drawn at a pixel of the screen; undefined: nothing is. */
function placeAt(x, y) {
  const got = new Uint8Array(4);
  render(1);
  gl.readPixels(Math.floor(x * view.width / wide), view.height - 1 - Math.floor(y * view.height / tall),
                1, 1, gl.RGBA, gl.UNSIGNED_BYTE, got);
  render(0);
  const z = got[0] / 255 + got[1] / 65025 + got[2] / 16581375;
  if (got[0] === 255 && got[1] === 255) return;
  const e = [(x - wide / 2 - eye.x) / scale(), (tall / 2 + eye.y - y) / scale(),
             -(2 * z - 1) * 2 * radius];
  return [0, 1, 2].map(c => e[0] * turn[0][c] + e[1] * turn[1][c] + e[2] * turn[2][c]);
}
/* The cell that holds a place best, seen as they are drawn. */
function cellAt(p) {
  let found = -1, best = -.05;
  for (let i = 0; i < C; i++) {
    const mid = centre(i), part = shrunk(), density = cell.density[i] / unit;
    if (part < 1 && (dot(mid, cut) > cut[3] || density < range[0] || density > range[1])) continue;
    const q = p.map((x, c) => mid[c] + (x - mid[c]) / part);
    const v = [0, 1, 2, 3].map(k => [0, 1, 2].map(c => at[3 * node[10 * i + k] + c] - q[c]));
    const whole = [1, 2, 3].map(k => v[k].map((x, c) => x - v[0][c]));
    const volume = dot(cross(whole[0], whole[1]), whole[2]);
    const least = Math.min(
      dot(cross(v[1], v[2]), v[3]) / volume, -dot(cross(v[0], v[2]), v[3]) / volume,
      dot(cross(v[0], v[1]), v[3]) / volume, -dot(cross(v[0], v[1]), v[2]) / volume);
    if (least > best) [found, best] = [i, least];
  }
  return found;
}
/* Share of a tetrahedron in which what is linear between its corners is above a level. */
function shareAbove(corner, level) {
  const h = corner.map(v => v - level).sort((a, b) => b - a), up = h.filter(v => v > 0).length;
  const cube = (k, others) => others.reduce((v, o) => v * h[k] / (h[k] - h[o]), 1);
  if (up === 0) return 0;
  if (up === 4) return 1;
  if (up === 1) return cube(0, [1, 2, 3]);
  if (up === 3) return 1 - cube(3, [0, 1, 2]);
  const [a, b, c, d] = h, ac = a / (a - c), ad = a / (a - d), bc = b / (b - c), bd = b / (b - d);
  return ac * ad + ac * bd * (1 - ad) + bc * bd * (1 - ac);
}
const whole = (i, name, n = digits) => cell[name][i] === UNKNOWN ? "not known"
  : (cell[name][i] / 10 ** n).toFixed(n).replace("-", "−");
/* The sections whose slabs a cell reaches into. */
const sections = [...document.querySelectorAll("td[data-z]")].map(slot => ({ slot, z: +slot.dataset.z }))
  .sort((a, b) => a.z - b.z);
const slab = sections.reduce((least, r, i) => i ? Math.min(least, r.z - sections[i - 1].z || least)
  : least, Infinity);
function sectionsOf(i) {
  const z = [0, 1, 2, 3].map(k => from[2] + step[2] * xyz[2][node[10 * i + k]]);
  const [least, most] = [Math.min(...z), Math.max(...z)], half = .49 * slab;
  return sections.filter(r => r.z + half > least && r.z - half < most);
}
function tell() {
  const box = $("cell"), rows = [], i = chosen;
  $("number").value = i < 0 ? "" : cell.number[i];
  box.replaceChildren();
  if (i < 0) {
    box.append(make("p", "Click a cell, or give its number: its density, its bounds and its sections."));
    return;
  }
  const volume = cell.volume[i] / 10 ** volumeDigits;
  rows.push(["Mean density", whole(i, "density")], ["Certainly above", whole(i, "lower")],
    ["Certainly below", whole(i, "upper")], ["Samples", whole(i, "samples", 0)],
    ["Their residual, rms", whole(i, "residual")],
    ["Volume", whole(i, "volume", volumeDigits) + " µm³"]);
  if (cell.share[i] !== UNKNOWN) rows.push(["In the region", (cell.share[i] / 10).toFixed(1) + " %"]);
  range.forEach(level => {
    if (Math.abs(level) > 1e29) return;
    const own = [0, 1, 2, 3].map(k => s[node[10 * i + k]]);
    const [a, b] = [-cell.below[i], cell.above[i]].map(r =>
      volume * shareAbove(own.map(v => v + r / unit), level));
    rows.push([`Above ${said(level)}`, `${Math.floor(a)} to ${Math.ceil(b)} µm³`]);
  });
  rows.push(["Middle, µm", centre(i).map((v, c) => Math.round(v + middle[c])).join(", ")
    .replace(/-/g, "−")]);
  box.append(make("h3", "Cell " + cell.number[i]));
  const list = make("dl");
  for (const [name, value] of rows) list.append(make("dt", name), make("dd", value));
  box.append(list);
  const through = sectionsOf(i), strip = make("div");
  if (!sections.length) return;
  box.append(make("p", through.length ? "Its sections:" : "No section lies in it."));
  strip.className = "strip";
  for (const { slot, z } of through) {
    const picture = slot.querySelector("img"), large = slot.querySelector("a.glass"), link = make("a");
    link.href = large ? large.getAttribute("href") : "#" + slot.id;
    if (picture) link.append(picture.cloneNode());
    link.append(make("span", `${slot.querySelector(".who").textContent}, z ${z} µm`));
    strip.append(link);
  }
  box.append(strip);
}
function make(kind, text) {
  const element = document.createElement(kind);
  if (text) element.textContent = text;
  return element;
}
function choose(i) {
  chosen = i;
  tell();
  later();
}

/* ---- hands ---- */

const pointers = new Map();
let moved = 0, pinch = 0, settle = 0;
/* While it moves, a slow machine draws fewer pixels. */
function hurry() {
  const began = performance.now();
  clearTimeout(settle);
  settle = setTimeout(() => { coarse = 1; later(); }, 200);
  requestAnimationFrame(() => requestAnimationFrame(() => {
    const took = performance.now() - began;
    if (took > 80) coarse = Math.min(3, coarse + .5);
  }));
  later();
}
function turned() {
  eye.elevation = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, eye.elevation));
  lookAround();
  if (field("cut") !== "none") setCut();
  hurry();
}
view.addEventListener("pointerdown", e => {
  pointers.set(e.pointerId, [e.clientX, e.clientY]);
  view.setPointerCapture(e.pointerId);
  moved = pointers.size > 1 ? 99 : 0;
  pinch = 0;
});
view.addEventListener("pointermove", e => {
  const was = pointers.get(e.pointerId);
  if (!was) return;
  const dx = e.clientX - was[0], dy = e.clientY - was[1];
  pointers.set(e.pointerId, [e.clientX, e.clientY]);
  moved += Math.abs(dx) + Math.abs(dy);
  if (pointers.size > 1) {
    const [p, q] = [...pointers.values()], wide = Math.hypot(p[0] - q[0], p[1] - q[1]);
    if (pinch) zoom(wide / pinch);
    pinch = wide;
    eye.x += dx / 2;
    eye.y += dy / 2;
    hurry();
  } else if (e.shiftKey || e.buttons & 6) {
    eye.x += dx;
    eye.y += dy;
    hurry();
  } else {
    eye.azimuth += dx * .008;
    eye.elevation += dy * .008;
    turned();
  }
});
for (const name of ["pointerup", "pointercancel"])
  view.addEventListener(name, e => {
    const alone = pointers.size === 1;
    pointers.delete(e.pointerId);
    if (name === "pointerup" && alone && moved < 5 && e.button === 0) {
      const box = view.getBoundingClientRect();
      const p = placeAt(e.clientX - box.left, e.clientY - box.top);
      choose(p ? cellAt(p.map((x, c) => x - 1e-3 * radius * turn[2][c])) : -1);
    }
  });
view.addEventListener("contextmenu", e => e.preventDefault());
/* With the key held, or where the model has the focus: a page that is read is scrolled past. */
view.addEventListener("wheel", e => {
  if (!e.ctrlKey && document.activeElement !== view) return;
  e.preventDefault();
  zoom(Math.exp(-e.deltaY / 500));
}, { passive: false });
function zoom(by) {
  const was = eye.zoom;
  eye.zoom = Math.max(.5, Math.min(20, eye.zoom * by));
  eye.x *= eye.zoom / was;
  eye.y *= eye.zoom / was;
  hurry();
}
function home() {
  Object.assign(eye, HOME);
  turned();
}
function slide(name, by) {
  $(name).value = +field(name) + by;
  $(name).dispatchEvent(new Event("input"));
}
view.addEventListener("keydown", e => {
  const keys = {
    ArrowLeft: () => { eye.azimuth -= .1; turned(); },
    ArrowRight: () => { eye.azimuth += .1; turned(); },
    ArrowUp: () => { eye.elevation -= .1; turned(); },
    ArrowDown: () => { eye.elevation += .1; turned(); },
    "+": () => zoom(1.2), "=": () => zoom(1.2), "-": () => zoom(1 / 1.2), "0": home,
    PageUp: () => slide("place", 20), PageDown: () => slide("place", -20),
    Escape: () => choose(-1),
  };
  if (!keys[e.key] || e.ctrlKey || e.metaKey || e.altKey) return;
  e.preventDefault();
  keys[e.key]();
});
$("home").addEventListener("click", home);
$("number").addEventListener("change", () => choose(cell.number.indexOf(+field("number"))));
for (const name of ["cut", "place"])
  $(name).addEventListener("input", () => { setCut(); hurry(); });
for (const name of ["from", "to"])
  $(name).addEventListener("input", () => { setRange(); hurry(); });
for (const name of ["shrink", "opacity"])
  $(name).addEventListener("input", () => { setShrink(); hurry(); });
for (const name of ["smooth", "true"])
  $(name).addEventListener("input", () => { drawScale(); later(); });
$("true").parentElement.hidden = !channels;

root.hidden = false;
$("none").hidden = true;
lookAround();
resize();
setShrink();
tell();
new ResizeObserver(resize).observe(view);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", resize);
})();
