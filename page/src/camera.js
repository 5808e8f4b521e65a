// Orbit camera: circles a target with z up, and moves smoothly to its goal.
import * as three from "three";

const SMOOTHING_TIME = 0.09; // [s], time constant
const MAX_ELEVATION = 1.5; // [rad]
const SMALL_HEIGHT = 450; // [px] of the scene

export class OrbitCamera {
  constructor(fov = 28) {
    this.camera = new three.PerspectiveCamera(fov, 1, 0.01, 10);
    this.camera.up.set(0, 0, 1);
    this.home = { azimuth: -1.25, elevation: 0.5, distance: 1, target: new three.Vector3() };
    this.goal = clone(this.home);
    this.now = clone(this.home);
    this.radius = 1;
    this.room = 0.9;
    this.still = new URLSearchParams(location.search).has("still") || matchMedia("(prefers-reduced-motion)").matches;
  }

  /** Frame a sphere so that it fills the view, or as the last one was framed, from the same direction. */
  fitSphere(sphere, keepView = false) {
    const { azimuth, elevation } = keepView ? this.goal : this.home;
    const share = keepView ? this.goal.distance / this.home.distance : 1;
    const aside = this.goal.target.clone().sub(this.home.target);
    this.radius = sphere.radius;
    this.home.target.copy(sphere.center);
    this.fit();
    const target = keepView ? sphere.center.clone().add(aside) : sphere.center.clone();
    this.goal = { ...clone(this.home), target, azimuth, elevation, distance: share * this.home.distance };
    this.now = clone(this.goal);
  }

  fit() {
    const half = Math.tan(three.MathUtils.degToRad(this.camera.fov / 2)) * Math.min(1, this.camera.aspect);
    this.home.distance = (this.room * this.radius) / Math.sin(Math.atan(half));
  }

  resize(aspect, height) {
    this.room = height < SMALL_HEIGHT ? 1.14 : 0.98; // view radius over body radius, with space for labels
    const share = this.goal.distance / this.home.distance;
    this.camera.aspect = aspect;
    this.fit();
    this.goal.distance = this.now.distance = share * this.home.distance;
    this.camera.updateProjectionMatrix();
  }

  rotate(dx, dy) {
    this.goal.azimuth -= 0.006 * dx;
    this.goal.elevation = Math.min(Math.max(this.goal.elevation + 0.006 * dy, -MAX_ELEVATION), MAX_ELEVATION);
  }

  zoom(factor) {
    const { distance } = this.home;
    this.goal.distance = Math.min(Math.max(this.goal.distance * factor, 0.12 * distance), 3 * distance);
  }

  pan(dx, dy, height) {
    const scale = this.metresPerPixel(height, this.goal.distance);
    const [x, y] = [0, 1].map((k) => new three.Vector3().setFromMatrixColumn(this.camera.matrixWorld, k));
    this.goal.target.addScaledVector(x, -dx * scale).addScaledVector(y, dy * scale);
    const off = this.goal.target.clone().sub(this.home.target);
    this.goal.target.copy(this.home.target).add(off.clampLength(0, 1.5 * this.radius));
  }

  reset() {
    const turns = Math.round((this.goal.azimuth - this.home.azimuth) / (2 * Math.PI));
    this.goal = clone(this.home);
    this.goal.azimuth += 2 * Math.PI * turns;
  }

  /** Size of a pixel [m] at a distance from the camera. */
  metresPerPixel(height, distance = this.now.distance) {
    return (2 * distance * Math.tan(three.MathUtils.degToRad(this.camera.fov / 2))) / height;
  }

  /** Advance by a time [s]; returns whether the camera moved. */
  update(seconds) {
    const share = this.still ? 1 : 1 - Math.exp(-seconds / SMOOTHING_TIME);
    const { now, goal } = this;
    const rest = Math.abs(goal.azimuth - now.azimuth) + Math.abs(goal.elevation - now.elevation)
      + Math.abs(goal.distance - now.distance) / this.radius + goal.target.distanceTo(now.target) / this.radius;
    for (const name of ["azimuth", "elevation", "distance"]) now[name] += share * (goal[name] - now[name]);
    now.target.lerp(goal.target, share);
    const flat = Math.cos(now.elevation);
    const away = [flat * Math.cos(now.azimuth), flat * Math.sin(now.azimuth), Math.sin(now.elevation)];
    this.camera.position.fromArray(away).multiplyScalar(now.distance).add(now.target);
    this.camera.near = Math.max(now.distance - 4 * this.radius, 0.02 * this.radius);
    this.camera.far = now.distance + 6 * this.radius;
    this.camera.lookAt(now.target);
    this.camera.updateProjectionMatrix();
    this.camera.updateMatrixWorld();
    return rest > 1e-4;
  }
}

const clone = ({ target, ...numbers }) => ({ ...numbers, target: target.clone() });
