// Bodies with a skin, drawn by WebGL on a canvas of their own and copied into the page's; null without WebGL.
// A vertex is v = sum_j w_j (R_j (v_rest - rest_j) + p_j), mm; the view is that of `project` in the player.
function skins(data, numbers) {
  const canvas = document.createElement("canvas");
  const gl = canvas.getContext("webgl", { preserveDrawingBuffer: true });
  if (!gl || gl.getParameter(gl.MAX_VERTEX_UNIFORM_VECTORS) < 80) return null;
  const source = {
    VERTEX_SHADER: "attribute vec3 rest, normal, tint; attribute vec4 joints, weights; uniform vec4 rows[72];" +
      "uniform vec4 view; uniform vec2 size; varying vec3 lit;" +
      "void main() { vec4 r0 = vec4(0.), r1 = vec4(0.), r2 = vec4(0.);" +
      "for (int k = 0; k < 4; k++) { int j = 3 * int(joints[k] + .5); float w = weights[k];" +
      "r0 += w * rows[j]; r1 += w * rows[j + 1]; r2 += w * rows[j + 2]; }" +
      "vec4 v = vec4(rest, 1.); vec3 p = vec3(dot(r0, v), dot(r1, v), dot(r2, v));" +
      "vec3 n = normalize(vec3(dot(r0.xyz, normal), dot(r1.xyz, normal), dot(r2.xyz, normal)));" +
      // view: cos and sin of yaw and tilt. The eye is in front, so what is nearer has a larger depth.
      "float u = view.x * p.x + view.y * p.z, d = view.x * p.z - view.y * p.x, s = size.y / 2900.;" +
      "float up = view.z * p.y - view.w * d, near = view.w * p.y + view.z * d;" +
      "gl_Position = vec4(2. * s * u / size.x, 2. * s * up / size.y - .76, -near / 4000., 1.);" +
      "float toward = view.w * n.y + view.z * (view.x * n.z - view.y * n.x);" +
      "lit = tint * (.55 + .3 * max(toward, 0.) + .15 * max(n.y, 0.)); }",
    FRAGMENT_SHADER: "precision mediump float; varying vec3 lit; void main() { gl_FragColor = vec4(lit, 1.); }",
  };
  const program = gl.createProgram();
  for (const [kind, text] of Object.entries(source)) {
    const shader = gl.createShader(gl[kind]);
    gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return null;
  gl.useProgram(program); gl.enable(gl.DEPTH_TEST); gl.enable(gl.CULL_FACE);
  const faces = numbers(data.mesh.faces, Uint16Array), joints = numbers(data.mesh.joints, Uint8Array);
  const weights = Float32Array.from(numbers(data.mesh.weights, Uint8Array), w => w / 255);
  const rgb = text => [1, 3, 5].map(k => parseInt(text.slice(k, k + 2), 16) / 255);
  // Lighter than lines, and the trunk light grey.
  const light = c => Math.max(...c) - Math.min(...c) < .1 ? [.82, .82, .82] : c.map(x => .35 + .65 * x);
  const colours = data.colours.map(rgb).map(light);
  const tint = new Float32Array(3 * joints.length / 4).map((_, k) => [0, 1, 2, 3].reduce((sum, i) => {
    const at = 4 * Math.floor(k / 3) + i;
    return sum + weights[at] * colours[joints[at]][k % 3];
  }, 0));
  const grey = new Float32Array(tint.length).fill(.8);
  function buffer(values) {
    const b = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, b); gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    return b;
  }
  function normals(v) {
    const n = new Float32Array(v.length);
    for (let f = 0; f < faces.length; f += 3) {
      const [a, b, c] = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]], e = [], g = [];
      for (let k = 0; k < 3; k++) { e.push(v[b + k] - v[a + k]); g.push(v[c + k] - v[a + k]); }
      for (let k = 0; k < 3; k++) {
        const i = (k + 1) % 3, j = (k + 2) % 3, out = e[i] * g[j] - e[j] * g[i];
        n[a + k] += out; n[b + k] += out; n[c + k] += out;
      }
    }
    return n;
  }
  const shared = { joints: [4, buffer(Float32Array.from(joints))], weights: [4, buffer(weights)] };
  const skin = buffer(tint), ghostly = buffer(grey);
  const bodies = data.mesh.bodies.map(b => {
    const v = Float32Array.from(numbers(b.vertices, Int16Array));
    return { rest: numbers(b.rest, Int16Array), of: { rest: [3, buffer(v)], normal: [3, buffer(normals(v))] } };
  });
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
  const place = name => gl.getUniformLocation(program, name);
  const at = { rows: place("rows"), view: place("view"), size: place("size") };
  const rows = new Float32Array(288);
  function pose(track, frame, rest) {
    const p = track.p, q = track.q;
    for (let j = 0; j < 24; j++) {
      const i = 96 * frame + 4 * j, s = 1 / Math.hypot(q[i], q[i + 1], q[i + 2], q[i + 3]);
      const w = q[i] * s, x = q[i + 1] * s, y = q[i + 2] * s, z = q[i + 3] * s;
      const R = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
                 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)];
      for (let k = 0; k < 3; k++) {
        let shift = p[72 * frame + 3 * j + k];
        for (let m = 0; m < 3; m++) {
          rows[12 * j + 4 * k + m] = R[3 * k + m];
          shift -= R[3 * k + m] * rest[3 * j + m];
        }
        rows[12 * j + 4 * k + 3] = shift;
      }
    }
  }
  return function (g, track, frame, cell, yaw, tilt, ghost) {
    const w = Math.round(cell.w), h = Math.round(cell.h), b = bodies[track.body];
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    gl.viewport(0, 0, w, h); gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    pose(track, frame, b.rest);
    gl.uniform4fv(at.rows, rows); gl.uniform2f(at.size, cell.w, cell.h);
    gl.uniform4f(at.view, Math.cos(yaw), Math.sin(yaw), Math.cos(tilt), Math.sin(tilt));
    const attributes = { ...shared, ...b.of, tint: [3, ghost ? ghostly : skin] };
    for (const [name, [width, values]] of Object.entries(attributes)) {
      const location = gl.getAttribLocation(program, name);
      gl.bindBuffer(gl.ARRAY_BUFFER, values); gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, width, gl.FLOAT, false, 0, 0);
    }
    gl.drawElements(gl.TRIANGLES, faces.length, gl.UNSIGNED_SHORT, 0);
    g.globalAlpha = ghost ? .45 : 1; g.drawImage(canvas, cell.x, cell.y); g.globalAlpha = 1;
  };
}
