// The line along which a cut opens the surface of a body: dark, as wide at every distance, on the curved triangles.
import * as three from "three";
import { cutLineShader } from "./shaders.js";

const PARTS = 4; // of a piece, between which it is straight
const WIDTH = 3; // [px]
const COLOUR = "#26040a";

export class CutLine {
  /** `line` has the corners [3 l] of the triangles of its pieces, and their ends [4 l]; `body` is the mesh with them. */
  constructor(line, body) {
    const shape = new three.InstancedBufferGeometry();
    const strip = Array.from({ length: PARTS + 1 }, (_, k) => [k / PARTS, -1, 0, k / PARTS, 1, 0]).flat();
    const index = Array.from({ length: PARTS }, (_, k) => [2 * k, 2 * k + 2, 2 * k + 1, 2 * k + 1, 2 * k + 2, 2 * k + 3]).flat();
    shape.setAttribute("position", new three.Float32BufferAttribute(strip, 3));
    shape.setIndex(index);
    shape.setAttribute("corners", new three.InstancedBufferAttribute(new Float32Array(line.corners), 3));
    shape.setAttribute("ends", new three.InstancedBufferAttribute(line.ends, 4));
    shape.instanceCount = line.corners.length / 3;
    const { defines, uniforms } = body.material;
    this.window = new three.Vector2();
    this.material = new three.ShaderMaterial({
      glslVersion: three.GLSL3,
      vertexShader: cutLineShader.vertex,
      fragmentShader: cutLineShader.fragment,
      defines: { WIDTH: defines.WIDTH, ...(body.parts > 1 ? { REFINED: true } : {}) },
      side: three.DoubleSide,
      uniforms: {
        positions: { value: body.texture }, normals: uniforms.normals, colour: { value: new three.Color(COLOUR) },
        window: { value: this.window }, width: { value: WIDTH },
      },
    });
    this.mesh = new three.Mesh(shape, this.material);
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = 1; // after the body
    this.mesh.onBeforeRender = (renderer) => renderer.getSize(this.window);
  }

  dispose() {
    this.mesh.geometry.dispose();
    this.material.dispose();
  }
}
