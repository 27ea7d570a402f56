/** Renderer without WebGL: draws the body as thick lines, nearest last. */

import type { OrbitCamera, Projected } from "./camera";
import type { Body, Renderer, Scene } from "./scene";
import { FLOOR, contextOf } from "./scene";
import { theme } from "./theme";
import {
  EYE_RADIUS,
  HEAD,
  HEAD_RADIUS,
  LEFT_EYE,
  LIMBS,
  RIGHT_EYE,
  colourOf,
  css,
  eyeOnHead,
  hatchOf,
  headCentre,
  pointAt,
  sideOf,
  type Vec3,
} from "./body";

type Project = ReturnType<OrbitCamera["projector"]>;

interface Piece {
  depth: number;
  draw: (context: CanvasRenderingContext2D) => void;
}

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
      const pieces = piecesOf(body, project).sort((a, b) => b.depth - a.depth);
      for (const piece of pieces) piece.draw(context);
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
      // In short pieces, because a line that passes behind the camera has no projected end.
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

function piecesOf(body: Body, project: Project): Piece[] {
  const pieces: Piece[] = [];
  const at = (point: number): Projected | null => project(pointAt(body.track, body.frame, point));
  for (const limb of LIMBS) {
    const from = at(limb.from);
    const to = at(limb.to);
    if (!from || !to) continue;
    const side = sideOf(limb.to);
    const colour = css(colourOf(body.paint, limb.joint, side));
    const hatch = hatchOf(body.paint, limb.joint, side);
    const width = Math.max(3, limb.radius * (from.scale + to.scale));
    pieces.push({
      depth: (from.depth + to.depth) / 2,
      draw: (context) => {
        context.lineCap = "round";
        const line = (stroke: string, thickness: number, dash: number[]): void => {
          context.strokeStyle = stroke;
          context.lineWidth = thickness;
          context.setLineDash(dash);
          context.beginPath();
          context.moveTo(from.x, from.y);
          context.lineTo(to.x, to.y);
          context.stroke();
        };
        line("rgba(28, 39, 51, 0.35)", width + 2, []);
        line(hatch ? css(hatch) : colour, width, []);
        if (hatch) {
          context.lineCap = "butt";
          line(colour, width, [4, 4]);
        }
        context.setLineDash([]);
      },
    });
  }
  const ball = (centre: Vec3, radius: number, fill: string): void => {
    const seen = project(centre);
    if (!seen) return;
    pieces.push({
      depth: seen.depth,
      draw: (context) => {
        context.fillStyle = fill;
        context.beginPath();
        context.arc(seen.x, seen.y, Math.max(2, radius * seen.scale), 0, 2 * Math.PI);
        context.fill();
      },
    });
  };
  ball(headCentre(body.track, body.frame), HEAD_RADIUS, css(colourOf(body.paint, HEAD, "middle")));
  for (const eye of [LEFT_EYE, RIGHT_EYE]) ball(eyeOnHead(body.track, body.frame, eye), EYE_RADIUS, "#1f242b");
  return pieces;
}
