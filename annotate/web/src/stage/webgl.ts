/** The stage in three.js: bodies of instanced spheres and cylinders, which together are capsules. */

import type * as Three from "../vendor-three";
import type { Body, Renderer, Scene } from "./scene";
import { FLOOR } from "./scene";
import { LIMBS, piecesOf, type Rgb, type Vec3 } from "./body";
import { theme, type Theme } from "./theme";

type Lib = typeof Three;

/** Number of spheres: two ends of every limb, the pelvis, the head and two eyes. */
const SPHERES = LIMBS.length * 2 + 4;

/** Hatching of soft joints: diagonal stripes of the resting colour in screen space. */
function hatch(material: Three.MeshLambertMaterial): void {
  material.onBeforeCompile = (shader) => {
    shader.vertexShader = shader.vertexShader
      .replace("#include <common>", "#include <common>\nattribute vec4 rest;\nvarying vec4 vRest;")
      .replace("#include <begin_vertex>", "#include <begin_vertex>\nvRest = rest;");
    shader.fragmentShader = shader.fragmentShader
      .replace("#include <common>", "#include <common>\nvarying vec4 vRest;")
      .replace(
        "#include <color_fragment>",
        "#include <color_fragment>\nif (vRest.a > 0.5 && mod(gl_FragCoord.x + gl_FragCoord.y, 8.0) < 4.0) diffuseColor.rgb = vRest.rgb;",
      );
  };
}

type Instance = ReturnType<typeof instance>;

function instance(lib: Lib) {
  return {
    matrix: new lib.Matrix4(),
    quaternion: new lib.Quaternion(),
    position: new lib.Vector3(),
    size: new lib.Vector3(),
    direction: new lib.Vector3(),
    up: new lib.Vector3(0, 1, 0),
    colour: new lib.Color(),
  };
}

class BodyMesh {
  readonly group: Three.Group;
  private readonly spheres: Three.InstancedMesh;
  private readonly tubes: Three.InstancedMesh;
  private readonly material: Three.MeshLambertMaterial;
  private readonly shadowMaterial: Three.MeshBasicMaterial;
  private readonly sphereRest: Three.InstancedBufferAttribute;
  private readonly tubeRest: Three.InstancedBufferAttribute;
  /** Values of one instance, reused for each instance. */
  private readonly own: Instance;

  constructor(lib: Lib) {
    this.own = instance(lib);
    this.group = new lib.Group();
    this.material = new lib.MeshLambertMaterial({ transparent: true });
    hatch(this.material);
    const sphere = new lib.SphereGeometry(1, 20, 14);
    const tube = new lib.CylinderGeometry(1, 1, 1, 18, 1, true);
    this.sphereRest = new lib.InstancedBufferAttribute(new Float32Array(SPHERES * 4), 4);
    this.tubeRest = new lib.InstancedBufferAttribute(new Float32Array(LIMBS.length * 4), 4);
    sphere.setAttribute("rest", this.sphereRest);
    tube.setAttribute("rest", this.tubeRest);
    this.spheres = new lib.InstancedMesh(sphere, this.material, SPHERES);
    this.tubes = new lib.InstancedMesh(tube, this.material, LIMBS.length);
    this.group.add(this.spheres, this.tubes);

    // Vertical shadow: the same instances, flattened. The stencil darkens each pixel only once.
    this.shadowMaterial = new lib.MeshBasicMaterial({
      color: 0x1c2733,
      transparent: true,
      opacity: 0.16,
      depthWrite: false,
      stencilWrite: true,
      stencilFunc: lib.NotEqualStencilFunc,
      stencilRef: 1,
      stencilZPass: lib.ReplaceStencilOp,
    });
    const shadow = new lib.Group();
    for (const mesh of [this.spheres, this.tubes]) {
      const flat = new lib.InstancedMesh(mesh.geometry, this.shadowMaterial, mesh.count);
      flat.instanceMatrix = mesh.instanceMatrix;
      flat.frustumCulled = false;
      shadow.add(flat);
    }
    shadow.scale.y = 1e-4;
    shadow.position.y = 0.004;
    this.group.add(shadow);
    this.spheres.frustumCulled = false;
    this.tubes.frustumCulled = false;
  }

  update(body: Body): void {
    const { track, paint, ghost } = body;
    this.material.opacity = ghost ? 0.38 : 1;
    this.material.depthWrite = !ghost;
    this.shadowMaterial.visible = !ghost;
    const { direction, position, quaternion, size, up } = this.own;
    let sphere = 0;
    let tube = 0;
    for (const { from, to, radius, colour, hatch } of piecesOf(track, body.frame, paint)) {
      quaternion.identity();
      for (const end of to ? [from, to] : [from]) this.ball(sphere++, end, radius, colour, hatch);
      if (!to) continue;
      direction.set(to[0] - from[0], to[1] - from[1], to[2] - from[2]);
      const length = Math.max(1e-5, direction.length());
      quaternion.setFromUnitVectors(up, direction.divideScalar(length));
      position.set((from[0] + to[0]) / 2, (from[1] + to[1]) / 2, (from[2] + to[2]) / 2);
      size.set(radius, length, radius);
      this.place(this.tubes, tube++, colour, hatch, this.tubeRest);
    }
    for (const mesh of [this.spheres, this.tubes]) {
      mesh.instanceMatrix.needsUpdate = true;
      if (mesh.instanceColor) mesh.instanceColor.needsUpdate = true;
    }
    this.sphereRest.needsUpdate = true;
    this.tubeRest.needsUpdate = true;
  }

  dispose(): void {
    const { spheres, tubes, material, shadowMaterial } = this;
    for (const own of [spheres.geometry, tubes.geometry, spheres, tubes, material, shadowMaterial]) own.dispose();
  }

  private ball(index: number, at: Vec3, radius: number, colour: Rgb, hatched: Rgb | null): void {
    this.own.position.set(...at);
    this.own.size.setScalar(radius);
    this.place(this.spheres, index, colour, hatched, this.sphereRest);
  }

  private place(mesh: Three.InstancedMesh, index: number, colour: Rgb, hatched: Rgb | null, rest: Three.InstancedBufferAttribute): void {
    const { matrix, position, quaternion, size, colour: own } = this.own;
    mesh.setMatrixAt(index, matrix.compose(position, quaternion, size));
    mesh.setColorAt(index, own.setRGB(...colour, "srgb"));
    own.setRGB(...(hatched ?? colour), "srgb");
    rest.setXYZW(index, own.r, own.g, own.b, hatched ? 1 : 0);
  }
}

/** Lines of the floor, with the name of their colour in the theme. */
type FloorLine = [Three.LineBasicMaterial, "faint" | "line" | "axis"];

function floor(lib: Lib): { group: Three.Group; lines: FloorLine[] } {
  const group = new lib.Group();
  const materials: FloorLine[] = [];
  const lines = (step: number, skip: (k: number) => boolean, name: FloorLine[1]): void => {
    const points: number[] = [];
    for (let k = -FLOOR / step; k <= FLOOR / step; k += 1) {
      if (skip(k)) continue;
      points.push(k * step, 0, -FLOOR, k * step, 0, FLOOR, -FLOOR, 0, k * step, FLOOR, 0, k * step);
    }
    const geometry = new lib.BufferGeometry();
    geometry.setAttribute("position", new lib.BufferAttribute(new Float32Array(points), 3));
    const material = new lib.LineBasicMaterial();
    materials.push([material, name]);
    group.add(new lib.LineSegments(geometry, material));
  };
  lines(0.5, (k) => k % 2 === 0, "faint");
  lines(1, (k) => k === 0, "line");
  lines(FLOOR, (k) => k !== 0, "axis");
  return { group, lines: materials };
}

export class WebglRenderer implements Renderer {
  readonly kind = "webgl2";
  readonly canvas: HTMLCanvasElement;
  private readonly renderer: Three.WebGLRenderer;
  private readonly scene: Three.Scene;
  private readonly camera: Three.PerspectiveCamera;
  private readonly meshes: BodyMesh[] = [];
  private readonly lines: readonly FloorLine[];
  private theme: Theme | null = null;
  private width = 0;
  private height = 0;
  private ratio = 0;

  /** Throws without WebGL 2. */
  constructor(
    private readonly lib: Lib,
    private readonly idle: WebglRenderer[],
    antialias: boolean,
  ) {
    // Preserve the buffer for screenshots and tests.
    this.renderer = new lib.WebGLRenderer({ antialias, preserveDrawingBuffer: true, stencil: true });
    this.canvas = this.renderer.domElement;
    this.scene = new lib.Scene();
    this.scene.add(new lib.HemisphereLight(0xffffff, 0xb8c0c8, 2.2));
    const sun = new lib.DirectionalLight(0xffffff, 1.6);
    sun.position.set(2, 5, 3);
    const { group, lines } = floor(lib);
    this.lines = lines;
    this.scene.add(sun, group);
    this.camera = new lib.PerspectiveCamera(38, 1, 0.05, 60);
  }

  draw(scene: Scene): void {
    if (scene.width !== this.width || scene.height !== this.height || scene.pixelRatio !== this.ratio) {
      this.width = scene.width;
      this.height = scene.height;
      this.ratio = scene.pixelRatio;
      this.renderer.setPixelRatio(scene.pixelRatio);
      this.renderer.setSize(scene.width, scene.height, false);
      this.camera.aspect = scene.width / Math.max(1, scene.height);
    }
    const colours = theme();
    if (colours !== this.theme) {
      this.theme = colours;
      this.renderer.setClearColor(colours.ground, 1);
      for (const [material, name] of this.lines) material.color.set(colours[name]);
    }
    const pose = scene.camera.pose;
    this.camera.fov = (pose.fieldOfView * 180) / Math.PI;
    this.camera.position.set(...pose.eye);
    this.camera.lookAt(...pose.target);
    this.camera.updateProjectionMatrix();
    while (this.meshes.length < scene.bodies.length) {
      const mesh = new BodyMesh(this.lib);
      this.meshes.push(mesh);
      this.scene.add(mesh.group);
    }
    this.meshes.forEach((mesh, index) => {
      const body = scene.bodies[index];
      mesh.group.visible = body !== undefined;
      if (body) mesh.update(body);
    });
    this.renderer.render(this.scene, this.camera);
  }

  /** Detaches the renderer and keeps it for the next stage. */
  dispose(): void {
    this.canvas.remove();
    if (this.renderer.getContext().isContextLost()) {
      for (const mesh of this.meshes) mesh.dispose();
      this.renderer.dispose();
    } else {
      this.idle.push(this);
    }
  }
}

/** Creates renderers and reuses those of closed stages: a new context costs more than anything else on the page. */
export function rendererPool(lib: Lib, antialias: boolean): () => Renderer {
  const idle: WebglRenderer[] = [];
  return () => idle.pop() ?? new WebglRenderer(lib, idle, antialias);
}
