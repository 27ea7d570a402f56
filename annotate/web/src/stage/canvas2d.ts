/** Renderer without WebGL: draws the body as thick lines, nearest last. */

import type { OrbitCamera } from "./camera";
import type { Renderer, Scene } from "./scene";
import { FLOOR, contextOf } from "./scene";
import { theme } from "./theme";
import { piecesOf, type Piece, type Rgb } from "./body";

type Project = ReturnType<OrbitCamera["projector"]>;

/** A projected piece; nearer pieces are drawn over farther ones. */
interface Drawn {
  depth: number;
  draw: () => void;
}

const css = (colour: Rgb): string => `rgb(${colour.map((value) => Math.round(value * 255)).join(", ")})`;

export class CanvasRenderer implements Renderer {
  readonly kind = "canvas2d";
  readonly canvas = document.createElement("canvas");

  constructor() {
    if (!this.canvas.getContext("2d")) throw new Error("this browser draws neither WebGL nor Canvas 2D");
  }

  draw(scene: Scene): void {
    const context = contextOf(this.canvas, scene) as CanvasRenderingContext2D;
    context.fillStyle = theme().ground;
    context.fillRect(0, 0, scene.width, scene.height);
    const project = scene.camera.projector(scene.width, scene.height);
    drawFloor(context, project);
    for (const body of scene.bodies) {
      context.globalAlpha = body.ghost ? 0.38 : 1;
      const pieces = piecesOf(body.track, body.frame, body.paint).flatMap((piece) => drawnOf(context, project, piece) ?? []);
      for (const piece of pieces.sort((a, b) => b.depth - a.depth)) piece.draw();
    }
    context.globalAlpha = 1;
  }

  dispose(): void {
    this.canvas.remove();
  }
}

function drawFloor(context: CanvasRenderingContext2D, project: Project): void {
  const { axis, line } = theme();
  context.lineWidth = 1;
  for (let k = -FLOOR; k <= FLOOR; k += 1) {
    context.strokeStyle = k === 0 ? axis : line;
    for (const alongX of [true, false]) {
      context.beginPath();
      let open = false;
      // Draw short pieces, because a line that passes behind the camera has no projected end.
      for (let t = -FLOOR; t <= FLOOR; t += 1) {
        const at = project(alongX ? [t, 0, k] : [k, 0, t]);
        if (!at) {
          open = false;
          continue;
        }
        if (open) context.lineTo(at.x, at.y);
        else context.moveTo(at.x, at.y);
        open = true;
      }
      context.stroke();
    }
  }
}

/** Projects a piece; `null` if it is behind the camera. */
function drawnOf(context: CanvasRenderingContext2D, project: Project, { from, to, radius, colour, hatch }: Piece): Drawn | null {
  const begin = project(from);
  const end = to && project(to);
  if (!begin || (to && !end)) return null;
  if (!end) {
    const draw = (): void => {
      context.fillStyle = css(colour);
      context.beginPath();
      context.arc(begin.x, begin.y, Math.max(2, radius * begin.scale), 0, 2 * Math.PI);
      context.fill();
    };
    return { depth: begin.depth, draw };
  }
  const width = Math.max(3, radius * (begin.scale + end.scale));
  const line = (stroke: string, thickness: number, dash: number[]): void => {
    context.strokeStyle = stroke;
    context.lineWidth = thickness;
    context.setLineDash(dash);
    context.beginPath();
    context.moveTo(begin.x, begin.y);
    context.lineTo(end.x, end.y);
    context.stroke();
  };
  const draw = (): void => {
    context.lineCap = "round";
    line("rgba(28, 39, 51, 0.35)", width + 2, []);
    line(css(hatch ?? colour), width, []);
    if (!hatch) return;
    context.lineCap = "butt";
    line(css(colour), width, [4, 4]);
    context.setLineDash([]);
  };
  return { depth: (begin.depth + end.depth) / 2, draw };
}
