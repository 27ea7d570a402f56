// The viewers of a report: they show the motions of an item side by side, in sync.
//
// The script draws with WebGL 2 or, in browsers without it, with lines on a plain canvas. The motions lie in the page
// itself, as millimetres in base64, so that the file works without a server.
"use strict";
(() => {
  const START = [232, 131, 58], MIDDLE = [181, 84, 140], END = [47, 111, 208];
  const RADIUS = 0.035, HEAD_RADIUS = 0.1, HEAD = 15, NECK_AND_EYES = 22;
  const LEFT = new Set([1, 4, 7, 10, 13, 16, 18, 20, 22, 24, 25]);
  const SPEEDS = [0.1, 0.25, 0.5, 1, 2];
  const GHOST_SECS = 0.75;
  const FIELD = 0.6;
  // In a pane narrower than this share of its height, the picture shrinks, so that it shows the same width.
  const LEAST_ASPECT = 0.7;
  // Radius of a bone's mark minus the radius of the bone, in metres.
  const MARK = 0.032;
  const LEFT_HIP = 1, RIGHT_HIP = 2;

  // ---- Data -----------------------------------------------------------------------------------

  /** Decodes the positions of a motion, in metres, frame after frame. */
  function decoded(text) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const view = new DataView(bytes.buffer);
    const points = new Float32Array(bytes.length / 2);
    for (let at = 0; at < points.length; at += 1) points[at] = view.getInt16(2 * at, true) / 1000;
    return points;
  }

  function colour(share) {
    const [a, b, t] = share < 0.5 ? [START, MIDDLE, 2 * share] : [MIDDLE, END, 2 * share - 1];
    return a.map((value, at) => (value + (b[at] - value) * t) / 255);
  }

  /** A motion prepared for drawing: its decoded positions, number of frames and height of its floor. */
  function prepared(motion, parents) {
    const points = decoded(motion.points);
    const stride = 3 * parents.length;
    let floor = Infinity;
    for (let at = 1; at < points.length; at += 3) floor = Math.min(floor, points[at]);
    const marked = new Set(motion.marked);
    return { label: motion.label, parents, marked, points, stride, frames: points.length / stride, floor };
  }

  /** Bones of a frame: both ends, the radius, whether it is a left limb, and whether it is marked. */
  function bones(motion, frame) {
    const { parents, marked } = motion;
    const first = frame * motion.stride;
    const point = (joint) => {
      const at = first + 3 * joint;
      return [motion.points[at], motion.points[at + 1] - motion.floor, motion.points[at + 2]];
    };
    const found = [];
    for (let joint = 1; joint < parents.length; joint += 1) {
      // The eyes have no bone, because they lie on the ball of the head. Fingers are thin.
      if (joint === NECK_AND_EYES || joint === NECK_AND_EYES + 1) continue;
      const radius = joint >= NECK_AND_EYES ? 0.5 * RADIUS : RADIUS;
      // A joint rotates the bones to its children, so a bone is marked if its parent joint is.
      const mark = marked.has(parents[joint]);
      found.push({ a: point(parents[joint]), b: point(joint), radius, left: LEFT.has(joint), mark });
    }
    const [left, right, head] = [point(22), point(23), point(HEAD)];
    const middle = [0, 1, 2].map((i) => (left[i] + right[i]) / 2);
    const ball = [0, 1, 2].map((i) => 0.4 * middle[i] + 0.6 * head[i]);
    ball[1] += 0.03;
    found.push({ a: ball, b: ball, radius: HEAD_RADIUS, left: false, mark: marked.has(HEAD) });
    // The nose shows where the figure looks.
    const nose = [0, 1, 2].map((i) => ball[i] + 1.5 * (middle[i] - ball[i]));
    found.push({ a: ball, b: nose, radius: 0.03, left: false, mark: false });
    return found;
  }

  /** The direction that a motion's first frame faces, as an angle about the vertical from +z to +x. */
  function heading(motion) {
    const along = (axis) => motion.points[3 * LEFT_HIP + axis] - motion.points[3 * RIGHT_HIP + axis];
    return Math.atan2(-along(2), along(0));
  }

  // ---- Camera ---------------------------------------------------------------------------------

  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

  /** Axes and position of a camera. Its yaw is measured from the direction that the figure faces. */
  function lens(camera, target) {
    const { pitch, distance } = camera, yaw = camera.heading + camera.yaw;
    const back = [Math.sin(yaw) * Math.cos(pitch), Math.sin(pitch), Math.cos(yaw) * Math.cos(pitch)];
    const right = [Math.cos(yaw), 0, -Math.sin(yaw)];
    const up = cross(back, right);
    const eye = target.map((value, i) => value + distance * back[i]);
    return { right, up, back, eye };
  }

  /** The focal length, in half heights of a pane. */
  const focal = (aspect) => Math.min(aspect / LEAST_ASPECT, 1) / Math.tan(FIELD / 2);

  /** Column-major projection times view. */
  function matrix(camera, target, aspect) {
    const { right, up, back, eye } = lens(camera, target);
    const f = focal(aspect), near = 0.05, far = 100;
    const view = [
      right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
      -dot(right, eye), -dot(up, eye), -dot(back, eye), 1,
    ];
    const scale = [f / aspect, f], depth = [(far + near) / (near - far), 2 * far * near / (near - far)];
    const out = new Float32Array(16);
    for (let column = 0; column < 4; column += 1) {
      const at = 4 * column;
      out[at] = scale[0] * view[at];
      out[at + 1] = scale[1] * view[at + 1];
      out[at + 2] = depth[0] * view[at + 2] + depth[1] * view[at + 3];
      out[at + 3] = -view[at + 2];
    }
    return out;
  }

  // ---- WebGL ----------------------------------------------------------------------------------

  const BODY_VERTEX = `#version 300 es
    in vec3 place; in vec3 a; in vec3 b; in float radius; in vec4 paint;
    uniform mat4 camera; uniform vec3 eye;
    out vec3 normal; out vec4 tint; out vec3 toward;
    void main() {
      vec3 along = b - a; float size = length(along);
      vec3 z = size > 1e-5 ? along / size : vec3(0.0, 1.0, 0.0);
      vec3 x = normalize(abs(z.y) < 0.9 ? cross(z, vec3(0.0, 1.0, 0.0)) : cross(z, vec3(1.0, 0.0, 0.0)));
      vec3 y = cross(z, x);
      // place.z is the height on a capsule of length 0: beyond the equator belongs to the far end.
      vec3 local = place.x * x + place.y * y + place.z * z;
      vec3 centre = place.z > 0.0 ? b : a;
      vec3 point = centre + radius * local;
      normal = local; tint = paint; toward = eye - point;
      gl_Position = camera * vec4(point, 1.0);
    }`;
  const BODY_FRAGMENT = `#version 300 es
    precision mediump float;
    in vec3 normal; in vec4 tint; in vec3 toward; out vec4 colour;
    void main() {
      vec3 n = normalize(normal); vec3 v = normalize(toward);
      float sky = 0.62 + 0.28 * n.y; float lamp = max(dot(n, normalize(vec3(0.4, 0.8, 0.45))), 0.0);
      float rim = pow(1.0 - max(dot(n, v), 0.0), 3.0);
      colour = vec4(tint.rgb * (sky + 0.35 * lamp) + 0.12 * rim, tint.a);
    }`;
  const FLOOR_VERTEX = `#version 300 es
    in vec2 place; uniform mat4 camera; uniform vec3 centre; out vec2 at; out vec2 away;
    void main() {
      vec2 p = centre.xz + 8.0 * place; at = p; away = place;
      gl_Position = camera * vec4(p.x, 0.0, p.y, 1.0);
    }`;
  const FLOOR_FRAGMENT = `#version 300 es
    precision highp float;
    in vec2 at; in vec2 away; uniform vec3 ink; out vec4 colour;
    void main() {
      vec2 grid = abs(fract(at / 0.5 - 0.5) - 0.5) / fwidth(at / 0.5);
      float line = 1.0 - min(min(grid.x, grid.y), 1.0);
      float fade = max(1.0 - 1.6 * length(away), 0.0);
      colour = vec4(ink, (0.05 + 0.35 * line) * fade);
    }`;

  /** A unit sphere as triangles, its poles along z. */
  function sphere() {
    const rings = 10, slices = 14, corners = [], order = [];
    for (let ring = 0; ring <= rings; ring += 1) {
      // Two rings at the equator: the capsule's tube is the strip between them.
      for (const side of ring === rings / 2 ? [-1e-4, 1e-4] : [0]) {
        const angle = Math.PI * (ring / rings - 0.5);
        for (let slice = 0; slice <= slices; slice += 1) {
          const turn = 2 * Math.PI * slice / slices;
          corners.push(Math.cos(angle) * Math.cos(turn), Math.cos(angle) * Math.sin(turn), Math.sin(angle) + side);
        }
      }
    }
    for (let ring = 0; ring <= rings; ring += 1) {
      for (let slice = 0; slice < slices; slice += 1) {
        const at = ring * (slices + 1) + slice, above = at + slices + 1;
        order.push(at, at + 1, above, above, at + 1, above + 1);
      }
    }
    return { corners: new Float32Array(corners), order: new Uint16Array(order) };
  }

  function webgl(canvas) {
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: true });
    if (!gl) return null;
    const program = (vertex, fragment) => {
      const made = gl.createProgram();
      for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
        const shader = gl.createShader(kind);
        gl.shaderSource(shader, source);
        gl.compileShader(shader);
        gl.attachShader(made, shader);
      }
      gl.linkProgram(made);
      if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
      return made;
    };
    const body = program(BODY_VERTEX, BODY_FRAGMENT), ground = program(FLOOR_VERTEX, FLOOR_FRAGMENT);
    const mesh = sphere();
    const buffer = (kind, values) => {
      const made = gl.createBuffer();
      gl.bindBuffer(kind, made);
      gl.bufferData(kind, values, gl.STATIC_DRAW);
      return made;
    };
    const bodies = gl.createVertexArray();
    gl.bindVertexArray(bodies);
    buffer(gl.ARRAY_BUFFER, mesh.corners);
    const corner = gl.getAttribLocation(body, "place");
    gl.enableVertexAttribArray(corner);
    gl.vertexAttribPointer(corner, 3, gl.FLOAT, false, 0, 0);
    buffer(gl.ELEMENT_ARRAY_BUFFER, mesh.order);
    const instances = buffer(gl.ARRAY_BUFFER, new Float32Array(0));
    const FLOATS = 11;
    for (const [name, size, offset] of [["a", 3, 0], ["b", 3, 3], ["radius", 1, 6], ["paint", 4, 7]]) {
      const at = gl.getAttribLocation(body, name);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, size, gl.FLOAT, false, 4 * FLOATS, 4 * offset);
      gl.vertexAttribDivisor(at, 1);
    }
    const plane = gl.createVertexArray();
    gl.bindVertexArray(plane);
    buffer(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]));
    const edge = gl.getAttribLocation(ground, "place");
    gl.enableVertexAttribArray(edge);
    gl.vertexAttribPointer(edge, 2, gl.FLOAT, false, 0, 0);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);

    const capsules = (drawn) => {
      const values = new Float32Array(FLOATS * drawn.length);
      drawn.forEach(({ a, b, radius, paint }, at) => values.set([...a, ...b, radius, ...paint], FLOATS * at));
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.DYNAMIC_DRAW);
      gl.drawElementsInstanced(gl.TRIANGLES, mesh.order.length, gl.UNSIGNED_SHORT, 0, drawn.length);
    };

    return {
      name: "webgl2",
      clear() {
        gl.disable(gl.SCISSOR_TEST);
        gl.clearColor(0, 0, 0, 0);
        gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      },
      draw(pane, scene) {
        gl.enable(gl.SCISSOR_TEST);
        const bottom = canvas.height - pane.y - pane.height;
        gl.viewport(pane.x, bottom, pane.width, pane.height);
        gl.scissor(pane.x, bottom, pane.width, pane.height);
        const projection = matrix(scene.camera, scene.target, pane.width / pane.height);
        gl.useProgram(ground);
        gl.bindVertexArray(plane);
        gl.uniformMatrix4fv(gl.getUniformLocation(ground, "camera"), false, projection);
        gl.uniform3fv(gl.getUniformLocation(ground, "centre"), scene.target);
        gl.uniform3fv(gl.getUniformLocation(ground, "ink"), scene.ink);
        gl.depthMask(false);
        gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
        gl.depthMask(true);
        gl.useProgram(body);
        gl.bindVertexArray(bodies);
        gl.uniformMatrix4fv(gl.getUniformLocation(body, "camera"), false, projection);
        gl.uniform3fv(gl.getUniformLocation(body, "eye"), lens(scene.camera, scene.target).eye);
        gl.bindBuffer(gl.ARRAY_BUFFER, instances);
        // Only the far side of a mark is drawn, so that it appears as an outline of its bone.
        gl.enable(gl.CULL_FACE);
        gl.cullFace(gl.FRONT);
        capsules(scene.marks);
        gl.disable(gl.CULL_FACE);
        capsules(scene.bones);
      },
    };
  }

  // ---- Plain canvas ---------------------------------------------------------------------------

  function flat(canvas) {
    const pen = canvas.getContext("2d");
    return {
      name: "canvas2d",
      clear() { pen.clearRect(0, 0, canvas.width, canvas.height); },
      draw(pane, scene) {
        const { right, up, back, eye } = lens(scene.camera, scene.target);
        const scale = pane.height / 2 * focal(pane.width / pane.height);
        const seen = (point) => {
          const from = point.map((value, i) => value - eye[i]);
          const depth = Math.max(-dot(back, from), 0.05);
          return [
            pane.x + pane.width / 2 + scale * dot(right, from) / depth,
            pane.y + pane.height / 2 - scale * dot(up, from) / depth,
            depth,
          ];
        };
        pen.save();
        pen.beginPath();
        pen.rect(pane.x, pane.y, pane.width, pane.height);
        pen.clip();
        pen.lineCap = "round";
        const line = (a, b, width, style) => {
          const [from, to] = [seen(a), seen(b)];
          pen.strokeStyle = style;
          pen.lineWidth = Math.max(width * scale / from[2], 1);
          pen.beginPath();
          pen.moveTo(from[0], from[1]);
          pen.lineTo(to[0] + 0.01, to[1]);
          pen.stroke();
        };
        const ink = `rgba(${scene.ink.map((v) => Math.round(255 * v)).join(",")},0.15)`;
        const [cx, cz] = [Math.round(2 * scene.target[0]) / 2, Math.round(2 * scene.target[2]) / 2];
        for (let at = -2; at <= 2; at += 0.5) {
          line([cx + at, 0, cz - 2], [cx + at, 0, cz + 2], 0.004, ink);
          line([cx - 2, 0, cz + at], [cx + 2, 0, cz + at], 0.004, ink);
        }
        const depth = ({ a, b }) => dot(back, a) + dot(back, b);
        const sorted = [...scene.bones].sort((one, other) => depth(one) - depth(other));
        for (const bone of [...scene.marks, ...sorted]) {
          const [r, g, b, alpha] = bone.paint;
          line(bone.a, bone.b, 2 * bone.radius, `rgba(${[r, g, b].map((v) => Math.round(255 * v)).join(",")},${alpha})`);
        }
        pen.restore();
      },
    };
  }

  // ---- Page -----------------------------------------------------------------------------------

  function element(tag, attributes = {}, ...children) {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    made.append(...children);
    return made;
  }

  /** Fills an element with a viewer of the items. With a single item there is no choice. */
  function viewer(root, { parents, items }) {
    const camera = { heading: 0, yaw: 0.7, pitch: 0.2, distance: 4.2 };
    const choice = element("select", { "aria-label": "Item" });
    items.forEach((item, at) => choice.append(element("option", { value: String(at) }, item.caption)));
    let canvas = element("canvas", { tabindex: "0", role: "img", "aria-label": "Motions side by side; drag to turn, Space to play" });
    const labels = element("div", { class: "labels" });
    const stage = element("div", { class: "stage" }, canvas, labels);
    const play = element("button", { type: "button" }, "Play");
    const scrub = element("input", { type: "range", min: "0", value: "0", step: "1", "aria-label": "Frame" });
    const clock = element("output");
    const speed = element("select", { "aria-label": "Speed" });
    for (const value of SPEEDS) speed.append(element("option", { value: String(value) }, `${value}×`));
    speed.value = "1";
    const toggle = (label, checked) => {
      const box = element("input", { type: "checkbox" });
      box.checked = checked;
      return [box, element("label", {}, box, ` ${label}`)];
    };
    const [ghosts, ghostLabel] = toggle("trail", true);
    const [follow, followLabel] = toggle("follow", true);
    const note = element("p", { class: "head" });
    if (items.length > 1) root.append(choice, note);
    root.append(
      stage,
      element("div", { class: "transport" }, play, scrub, clock, speed, ghostLabel, followLabel),
    );

    let backend = null;
    try {
      backend = webgl(canvas);
    } catch (problem) {
      console.warn(problem);
    }
    function drawPlainly() {
      // A canvas cannot change the kind of its first context, so it is replaced.
      const fresh = canvas.cloneNode();
      canvas.replaceWith(fresh);
      canvas = fresh;
      backend = flat(canvas);
      root.dataset.renderer = backend.name;
    }
    if (backend) {
      root.dataset.renderer = backend.name;
      // Browsers keep about 16 contexts. In a page with more viewers, such as a long notebook, the oldest lose theirs.
      canvas.addEventListener("webglcontextlost", () => { drawPlainly(); redraw(); });
    } else {
      drawPlainly();
    }

    let item, motions, last, playing = false, visible = false, time = 0, before = null, asked = false;

    function open(at) {
      item = items[at];
      motions = item.motions.map((motion) => prepared(motion, parents));
      // Every item is first shown from the same side of its source.
      camera.heading = heading(motions[0]);
      last = Math.max(...motions.map((motion) => motion.frames)) - 1;
      // The list truncates long captions; this line shows the whole text.
      note.textContent = `“${item.caption}” · ${item.note}`;
      scrub.max = String(last);
      labels.replaceChildren(...motions.map((motion) => element("span", {}, motion.label)));
      labels.style.gridTemplateColumns = `repeat(${motions.length}, 1fr)`;
      seek(0);
    }

    function seek(frame) {
      time = Math.min(Math.max(frame, 0), last) / item.fps;
      redraw();
    }

    const frameNow = () => Math.min(Math.floor(time * item.fps + 1e-6), last);

    function setPlaying(value) {
      playing = value;
      before = null;
      play.textContent = playing ? "Pause" : "Play";
      if (playing && frameNow() >= last) time = 0;
      redraw();
    }

    function redraw() {
      if (asked) return;
      asked = true;
      requestAnimationFrame((now) => {
        asked = false;
        if (playing && visible) {
          if (before !== null) time += (now - before) / 1000 * Number(speed.value);
          before = now;
          if (time * item.fps > last + 0.5 * item.fps) time = 0;
        }
        paint();
        if (playing && visible) redraw();
      });
    }

    function paint() {
      const ratio = Math.min(window.devicePixelRatio || 1, 2);
      const [width, height] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
      if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
      const style = getComputedStyle(root);
      const ink = style.color.match(/[\d.]+/g).slice(0, 3).map((value) => Number(value) / 255);
      const green = style.getPropertyValue("--marked").match(/[\da-f]{2}/gi).map((pair) => parseInt(pair, 16) / 255);
      const frame = frameNow();
      backend.clear();
      motions.forEach((motion, at) => {
        // A shorter motion keeps its last frame.
        const own = Math.min(frame, motion.frames - 1);
        const drawn = [];
        const marks = bones(motion, own).filter((bone) => bone.mark)
          .map((bone) => ({ ...bone, radius: bone.radius + MARK, paint: [...green, 1] }));
        const add = (from, alpha) => {
          const tint = colour(motion.frames > 1 ? from / (motion.frames - 1) : 0);
          for (const bone of bones(motion, from)) {
            const shade = bone.left ? tint.map((value) => 0.55 * value + 0.4) : tint;
            drawn.push({ ...bone, paint: [...shade, alpha] });
          }
        };
        add(own, 1);
        if (ghosts.checked) {
          const step = Math.round(GHOST_SECS * item.fps);
          for (let from = 0; from < motion.frames; from += step) if (Math.abs(from - own) > step / 3) add(from, 0.16);
        }
        const at0 = motion.stride * (follow.checked ? own : 0);
        const target = [motion.points[at0], 0.9, motion.points[at0 + 2]];
        const left = Math.round(width * at / motions.length);
        const pane = { x: left, y: 0, width: Math.round(width * (at + 1) / motions.length) - left, height };
        backend.draw(pane, { camera, target, bones: drawn, marks, ink });
      });
      scrub.value = String(frame);
      clock.textContent = `${(frame / item.fps).toFixed(2)} s · frame ${frame}/${last}`;
      canvas.dataset.frame = String(frame);
    }

    choice.addEventListener("change", () => open(Number(choice.value)));
    play.addEventListener("click", () => setPlaying(!playing));
    scrub.addEventListener("input", () => { setPlaying(false); seek(Number(scrub.value)); });
    for (const box of [ghosts, follow]) box.addEventListener("change", redraw);
    stage.addEventListener("pointerdown", (event) => {
      if (event.target.tagName !== "CANVAS") return;
      event.target.setPointerCapture(event.pointerId);
      let [x, y] = [event.clientX, event.clientY];
      const move = (moved) => {
        camera.yaw -= (moved.clientX - x) / 150;
        camera.pitch = Math.min(Math.max(camera.pitch + (moved.clientY - y) / 200, -0.1), 1.5);
        [x, y] = [moved.clientX, moved.clientY];
        redraw();
      };
      event.target.addEventListener("pointermove", move);
      // The browser cancels a touch that scrolls the page.
      for (const end of ["pointerup", "pointercancel"]) {
        event.target.addEventListener(end, () => event.target.removeEventListener("pointermove", move), { once: true });
      }
    });
    stage.addEventListener("wheel", (event) => {
      // Without focus, the wheel scrolls the page.
      if (!stage.contains(document.activeElement)) return;
      event.preventDefault();
      camera.distance = Math.min(Math.max(camera.distance * Math.exp(event.deltaY / 800), 1.2), 12);
      redraw();
    }, { passive: false });
    stage.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: -1, ArrowRight: 1 };
      if (event.key === " ") setPlaying(!playing);
      else if (event.key in steps) { setPlaying(false); seek(frameNow() + steps[event.key] * (event.shiftKey ? 10 : 1)); }
      else if (event.key === "Home") seek(0);
      else if (event.key === "End") seek(last);
      else return;
      event.preventDefault();
    });
    new ResizeObserver(redraw).observe(stage);
    // A viewer that is out of sight does not play, so that several viewers cost no more than one.
    new IntersectionObserver(([seen]) => {
      visible = seen.isIntersecting;
      before = null;
      redraw();
    }).observe(stage);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
    open(0);
    if (!matchMedia("(prefers-reduced-motion: reduce)").matches) setPlaying(true);
  }

  for (const root of document.querySelectorAll(".viewer")) {
    viewer(root, JSON.parse(document.getElementById(`${root.id}-data`).textContent));
  }
})();
