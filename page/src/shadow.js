// A soft shadow on the ground: the silhouette from above, blurred.
import * as three from "three";
import { blurShader, groundShader } from "./shaders.js";

const TEXTURE_SIZE = 128;
const MARGIN = 0.6; // around the body, as a fraction of its radius
const BLUR = 0.0425; // step of the blur, as a fraction of the radius
const UPDATE_INTERVAL = 120; // [ms]; eight times as long in software, where it costs as much as the body

const shader = ({ vertex, fragment }, uniforms, more) =>
  new three.ShaderMaterial({ glslVersion: three.GLSL3, vertexShader: vertex, fragmentShader: fragment, uniforms, ...more });

export class Shadow {
  constructor(renderer, fine) {
    Object.assign(this, { renderer, every: fine ? UPDATE_INTERVAL : 8 * UPDATE_INTERVAL });
    this.strength = 0.34;
    this.last = -Infinity;
    const target = () => new three.WebGLRenderTarget(TEXTURE_SIZE, TEXTURE_SIZE, { depthBuffer: false });
    this.targets = [target(), target()];
    this.silhouette = new three.MeshBasicMaterial({ color: 0xffffff, side: three.DoubleSide });
    this.blurred = shader(blurShader, { image: { value: null }, along: { value: new three.Vector2() } }, { depthTest: false });
    const screen = new three.Mesh(new three.PlaneGeometry(2, 2), this.blurred);
    screen.frustumCulled = false;
    this.pass = new three.Scene().add(screen);
    this.flat = new three.Camera();
    this.above = new three.OrthographicCamera(-1, 1, 1, -1, 0, 10);
    this.uniforms = { image: { value: this.targets[0].texture }, strength: { value: 0 } };
    const material = shader(groundShader, this.uniforms, { transparent: true, depthWrite: false, premultipliedAlpha: true });
    this.plane = new three.Mesh(new three.PlaneGeometry(1, 1), material);
    this.plane.renderOrder = -1;
    this.plane.visible = false;
  }

  /** Place the shadow below a body. */
  fit({ box, sphere }) {
    const { radius } = sphere;
    const [x, y] = [box.max.x - box.min.x, box.max.y - box.min.y].map((size) => 0.5 * size + MARGIN * radius);
    this.floor = box.min.z - 0.1 * radius;
    this.plane.scale.set(2 * x, 2 * y, 1);
    this.plane.position.set(sphere.center.x, sphere.center.y, this.floor);
    Object.assign(this.above, { left: -x, right: x, top: y, bottom: -y, far: 14 * radius });
    this.above.position.set(sphere.center.x, sphere.center.y, sphere.center.z + 7 * radius);
    this.steps = [[(0.5 * BLUR * radius) / x, 0], [0, (0.5 * BLUR * radius) / y]];
    this.above.up.set(0, 1, 0);
    this.above.lookAt(sphere.center);
    this.above.updateProjectionMatrix();
    this.plane.visible = true;
    this.last = -Infinity;
  }

  update(body, camera) {
    const over = (camera.position.z - this.floor) / body.sphere.radius;
    this.uniforms.strength.value = this.strength * Math.min(Math.max(over, 0), 1); // hidden from below
    const now = performance.now();
    if (now - this.last < this.every) return;
    this.last = now;
    const { renderer, targets } = this;
    const scene = new three.Scene();
    const silhouette = new three.Mesh(body.shape, this.silhouette);
    silhouette.frustumCulled = false;
    renderer.setRenderTarget(targets[0]);
    renderer.clear();
    renderer.render(scene.add(silhouette), this.above);
    for (const [from, to, along] of [[0, 1, this.steps[0]], [1, 0, this.steps[1]]]) {
      this.blurred.uniforms.image.value = targets[from].texture;
      this.blurred.uniforms.along.value.set(...along);
      renderer.setRenderTarget(targets[to]);
      renderer.render(this.pass, this.flat);
    }
    renderer.setRenderTarget(null);
  }
}
