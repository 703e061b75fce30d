// Looking around a scene in three dimensions by mouse, fingers and keys.
import { PerspectiveCamera, Raycaster, Scene, Vector2, Vector3, WebGLRenderer } from "three";

const STEP_RAD = 0.2;
const KEYS: Record<string, [number, number, number]> = {
  ArrowLeft: [-STEP_RAD, 0, 1], ArrowRight: [STEP_RAD, 0, 1], ArrowUp: [0, STEP_RAD, 1], ArrowDown: [0, -STEP_RAD, 1],
  "+": [0, 0, 0.85], "-": [0, 0, 1.18],
};

export class Orbit {
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(35, 4 / 3, 0.001, 100);
  readonly center = new Vector3();
  size = 1;  // of what is looked at, metres
  azimuth = 0.8;
  height = 0.6;
  private distance = 2.2;
  private renderer?: WebGLRenderer;
  private pressed?: { x: number; y: number };
  private watcher = new ResizeObserver(() => this.draw());

  // False: the browser has no WebGL.
  attach(canvas: HTMLCanvasElement): boolean {
    try {
      this.renderer ??= new WebGLRenderer({ canvas, antialias: true, alpha: true });
    } catch {
      return false;
    }
    this.watcher.observe(canvas);
    return true;
  }

  detach() {
    this.watcher.disconnect();
    this.renderer?.dispose();
    this.renderer = undefined;
  }

  draw() {
    const canvas = this.renderer?.domElement;
    if (!canvas || !this.renderer || canvas.clientWidth === 0) return;
    this.renderer.setPixelRatio(Math.min(2, devicePixelRatio));
    this.renderer.setSize(canvas.clientWidth, canvas.clientHeight, false);
    this.place(canvas.clientWidth / canvas.clientHeight);
    this.renderer.render(this.scene, this.camera);
  }

  private place(aspect: number) {
    this.camera.aspect = aspect;
    this.camera.near = 0.01 * this.size;
    this.camera.far = 100 * this.size;
    const away = this.distance * this.size;
    this.camera.up.set(0, 0, 1);
    this.camera.position.set(
      this.center.x + away * Math.cos(this.height) * Math.cos(this.azimuth),
      this.center.y + away * Math.cos(this.height) * Math.sin(this.azimuth),
      this.center.z + away * Math.sin(this.height),
    );
    this.camera.lookAt(this.center);
    this.camera.updateProjectionMatrix();
  }

  turn(azimuth: number, height: number, zoom = 1) {
    this.azimuth += azimuth;
    this.height = Math.max(-1.5, Math.min(1.5, this.height + height));
    this.distance = Math.max(0.5, Math.min(20, this.distance * zoom));
    this.draw();
  }

  // From that side of what is looked at.
  lookFrom(side: Vector3) {
    this.azimuth = Math.atan2(side.y, side.x);
    this.height = Math.max(-1.5, Math.min(1.5, Math.atan2(side.z, Math.hypot(side.x, side.y))));
    this.draw();
  }

  // True: the key was one of ours.
  onKey(event: KeyboardEvent): boolean {
    const found = KEYS[event.key];
    if (!found) return false;
    event.preventDefault();
    this.turn(...found);
    return true;
  }

  onDown(event: PointerEvent) {
    (event.currentTarget as Element).setPointerCapture(event.pointerId);
    this.pressed = { x: event.clientX, y: event.clientY };
  }

  onMove(event: PointerEvent): boolean {
    if (!event.buttons) return false;
    this.turn(-0.01 * event.movementX, 0.01 * event.movementY);
    return true;
  }

  onWheel(event: WheelEvent) {
    event.preventDefault();
    this.turn(0, 0, event.deltaY > 0 ? 1.1 : 0.9);
  }

  // The ray of a click; none of a drag.
  onUp(event: PointerEvent): Raycaster | undefined {
    const from = this.pressed;
    this.pressed = undefined;
    if (!from || Math.hypot(event.clientX - from.x, event.clientY - from.y) > 4) return undefined;
    const box = (event.currentTarget as Element).getBoundingClientRect();
    const at = new Vector2((2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height);
    const ray = new Raycaster();
    this.camera.updateMatrixWorld();
    ray.setFromCamera(at, this.camera);
    return ray;
  }
}
