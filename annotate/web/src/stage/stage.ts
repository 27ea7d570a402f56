/** A view of bodies with tags and mouse control. Canvas 2D draws it where WebGL is missing or its context is lost. */

import { h } from "../dom";
import { OrbitCamera, type Preset } from "./camera";
import { CanvasRenderer } from "./canvas2d";
import { contextOf, pixelRatio, type Body, type Renderer, type Scene } from "./scene";
import { onThemeChange } from "./theme";
import { PELVIS, headingAt, pointAt } from "./body";

/** Creates a renderer; throws if it is not supported. */
export type MakeRenderer = () => Renderer;

/** Keypoints with a tag: wrists and feet. */
const TAGS: readonly (readonly [number, string, string])[] = [
  [20, "L", "#1c6bd4"],
  [10, "L", "#1c6bd4"],
  [21, "R", "#b9560a"],
  [11, "R", "#b9560a"],
];

export class Stage {
  readonly element: HTMLElement;
  readonly camera = new OrbitCamera();
  private renderer: Renderer;
  private readonly overlay: HTMLCanvasElement;
  private readonly caption: HTMLElement;
  private bodies: Body[] = [];
  private dirty = true;
  private disposed = false;
  private readonly observer: ResizeObserver;
  private readonly forget: () => void;
  followRoot = true;
  private followers: Stage[] = [];

  constructor(label: string, make: MakeRenderer) {
    this.renderer = tryMake(make);
    this.overlay = h("canvas", { class: "stage-overlay", attrs: { "aria-hidden": "true" } });
    this.caption = h("div", { class: "stage-caption" });
    this.element = h(
      "div",
      {
        class: "stage",
        attrs: { tabindex: 0, role: "img", "aria-label": label },
        data: { frame: "0", renderer: this.renderer.kind, bodies: "0" },
      },
      this.renderer.canvas,
      this.overlay,
      this.caption,
      h("div", { class: "stage-sides note", attrs: { "aria-hidden": "true" } },
        h("span", { class: "side-left" }, "L left"),
        h("span", { class: "side-right" }, "R right"),
        h("span", {}, "sides are the character's own"),
      ),
    );
    this.renderer.canvas.setAttribute("aria-hidden", "true");
    this.renderer.canvas.addEventListener("webglcontextlost", this.contextLost);
    this.observer = new ResizeObserver(() => this.redraw());
    this.observer.observe(this.element);
    this.forget = onThemeChange(() => this.redraw());
    this.mouse();
  }

  link(other: Stage): void {
    this.followers.push(other);
    other.followers.push(this);
  }

  setCaption(text: string): void {
    if (this.caption.textContent !== text) this.caption.textContent = text;
  }

  setLabel(text: string): void {
    if (this.element.getAttribute("aria-label") !== text) this.element.setAttribute("aria-label", text);
  }

  show(bodies: Body[], clockFrame: number): void {
    this.bodies = bodies;
    this.element.dataset.frame = String(clockFrame);
    this.element.dataset.clipFrame = String(bodies[0]?.frame ?? 0);
    this.element.dataset.bodies = String(bodies.length);
    this.follow();
    this.redraw();
  }

  /** Puts the camera in front of the body at its first frame. */
  frameBody(): void {
    const first = this.bodies[0];
    if (!first) return;
    this.camera.heading = headingAt(first.track, 0);
    this.camera.use(this.camera.preset);
    this.camera.target = pointAt(first.track, 0, PELVIS);
    this.camera.target[1] = 0.9;
    this.redraw();
  }

  useCamera(preset: Preset): void {
    this.camera.use(preset);
    this.element.dataset.camera = preset;
    this.follow();
    this.redraw();
    for (const other of this.followers) {
      other.camera.heading = this.camera.heading;
      other.camera.use(preset);
      other.element.dataset.camera = preset;
      other.redraw();
    }
  }

  setFollow(follow: boolean): void {
    this.followRoot = follow;
    this.follow();
    this.redraw();
  }

  redraw(): void {
    this.dirty = true;
  }

  /** Draws if anything changed; called once per animation frame. */
  drawIfNeeded(): void {
    if (!this.dirty || this.disposed || !this.element.isConnected) return;
    const width = this.element.clientWidth;
    const height = this.element.clientHeight;
    if (width === 0 || height === 0) return;
    this.dirty = false;
    const scene: Scene = { bodies: this.bodies, camera: this.camera, width, height, pixelRatio: pixelRatio() };
    try {
      this.renderer.draw(scene);
    } catch (error) {
      if (this.renderer.kind === "canvas2d") throw error;
      this.fallBack();
      this.renderer.draw(scene);
    }
    this.drawTags(scene);
  }

  dispose(): void {
    this.disposed = true;
    this.observer.disconnect();
    this.forget();
    this.renderer.canvas.removeEventListener("webglcontextlost", this.contextLost);
    this.renderer.dispose();
  }

  private readonly contextLost = (event: Event): void => {
    event.preventDefault();
    if (!this.disposed) this.fallBack();
  };

  private fallBack(): void {
    const canvas = this.renderer.canvas;
    canvas.removeEventListener("webglcontextlost", this.contextLost);
    this.renderer = new CanvasRenderer();
    this.renderer.canvas.setAttribute("aria-hidden", "true");
    canvas.replaceWith(this.renderer.canvas);
    this.element.dataset.renderer = this.renderer.kind;
    this.redraw();
  }

  private follow(): void {
    const first = this.bodies[0];
    if (!first || !this.followRoot) return;
    const [x, , z] = pointAt(first.track, first.frame, PELVIS);
    this.camera.target = [x, this.camera.target[1], z];
  }

  private drawTags(scene: Scene): void {
    const context = contextOf(this.overlay, scene);
    if (!context) return;
    context.clearRect(0, 0, scene.width, scene.height);
    const project = scene.camera.projector(scene.width, scene.height);
    context.font = "600 11px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    for (const body of scene.bodies) {
      if (body.ghost) continue;
      for (const [point, text, colour] of TAGS) {
        const at = project(pointAt(body.track, body.frame, point));
        if (!at) continue;
        context.fillStyle = "rgba(255, 255, 255, 0.86)";
        context.beginPath();
        context.arc(at.x, at.y, 8, 0, 2 * Math.PI);
        context.fill();
        context.fillStyle = colour;
        context.fillText(text, at.x, at.y + 0.5);
      }
    }
  }

  private mouse(): void {
    const { element } = this;
    let pan = false;
    element.addEventListener("pointerdown", (event) => {
      if (event.button > 2) return;
      element.focus({ preventScroll: true });
      element.setPointerCapture(event.pointerId);
      pan = event.button !== 0 || event.shiftKey;
    });
    element.addEventListener("pointermove", ({ pointerId, movementX, movementY }) => {
      if (!element.hasPointerCapture(pointerId)) return;
      if (pan) this.moveCameras((camera) => camera.pan(movementX, movementY, element.clientHeight));
      else this.moveCameras((camera) => camera.orbit(movementX, movementY));
    });
    element.addEventListener("contextmenu", (event) => event.preventDefault());
    const zoom = (event: WheelEvent): void => {
      event.preventDefault();
      this.moveCameras((camera) => camera.zoom(Math.exp(event.deltaY * 0.001)));
    };
    element.addEventListener("wheel", zoom, { passive: false });
  }

  private moveCameras(move: (camera: OrbitCamera) => void): void {
    for (const stage of [this, ...this.followers]) {
      move(stage.camera);
      stage.redraw();
    }
  }
}

function tryMake(make: MakeRenderer): Renderer {
  try {
    return make();
  } catch {
    return new CanvasRenderer();
  }
}
