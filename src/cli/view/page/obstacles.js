// Obstacles: solid as they were seen, a shell as far as the loop grows them, a label with the distance.

import * as THREE from "three";
import { ConvexGeometry } from "./vendor/three/examples/jsm/geometries/ConvexGeometry.js";
import { styled } from "./colours.js";

/** Labels that are shown at most, the nearest first. */
const LABELS = 10;

/** Shape of an obstacle, grown by a distance; a box and a hull keep their corners. */
function shape(o, growth, size) {
  const [a, b, c] = o.dimensions_m;
  switch (o.kind) {
    case "ball":
      return new THREE.SphereGeometry(a + growth, 40, 24);
    case "capsule":
      return new THREE.CapsuleGeometry(b + growth, 2 * a, 12, 32).rotateX(Math.PI / 2);
    case "box":
      return new THREE.BoxGeometry(2 * (a + growth), 2 * (b + growth), 2 * (c + growth));
    case "half-space":
      return new THREE.PlaneGeometry(3 * size, 3 * size, 12, 12).translate(0, 0, growth);
    case "hull": {
      const points = o.vertices_m.map((v) => new THREE.Vector3(...v));
      const middle = points.reduce((sum, p) => sum.add(p), new THREE.Vector3()).divideScalar(points.length || 1);
      for (const p of points) {
        const out = p.clone().sub(middle);
        p.addScaledVector(out.normalize(), growth);
      }
      return new ConvexGeometry(points);
    }
    default:
      return new THREE.SphereGeometry(0.02 * size);
  }
}

export class Obstacles {
  constructor(labels) {
    this.group = new THREE.Group();
    this.labels = labels;
    this.known = new Map();
    this.size = 1;
    this.clearance = 0;
  }

  /** Steps in which a shell follows the growth (m): a shape is made anew for each. */
  step() {
    return this.size / 1000;
  }

  make(o) {
    const flat = o.kind === "half-space";
    const side = flat ? THREE.DoubleSide : THREE.FrontSide;
    const body = new THREE.MeshStandardMaterial({ roughness: 0.7, side, transparent: true, opacity: flat ? 0.25 : 0.8 });
    const shell = new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.13, depthWrite: false, side });
    const item = { body: new THREE.Mesh(shape(o, 0, this.size), body), shell: new THREE.Mesh(new THREE.BufferGeometry(), shell) };
    item.growth = -1;
    item.body.geometry.computeBoundingSphere();
    item.radius = flat ? 0 : item.body.geometry.boundingSphere.radius;
    item.label = document.createElement("span");
    this.group.add(item.body, item.shell);
    return item;
  }

  drop(item) {
    this.group.remove(item.body, item.shell);
    for (const mesh of [item.body, item.shell]) {
      mesh.geometry.dispose();
      mesh.material.dispose();
    }
    item.label.remove();
  }

  show(list) {
    const seen = new Set();
    this.crowd = new Set(list.map((o) => o.source)).size > 1;
    for (const o of list) {
      const key = `${o.source}/${o.id}/${o.kind}/${o.dimensions_m}/${o.vertices_m ?? ""}`;
      seen.add(key);
      if (!this.known.has(key)) this.known.set(key, this.make(o));
      this.place(this.known.get(key), o);
    }
    for (const [key, item] of this.known) {
      if (!seen.has(key)) {
        this.drop(item);
        this.known.delete(key);
      }
    }
  }

  place(item, o) {
    const growth = Math.ceil(o.growth_m / this.step()) * this.step();
    if (growth !== item.growth) {
      item.growth = growth;
      item.shell.geometry.dispose();
      item.shell.geometry = growth > 0 ? shape(o, growth, this.size) : new THREE.BufferGeometry();
    }
    const [w, x, y, z] = o.quaternion;
    for (const mesh of [item.body, item.shell]) {
      mesh.position.set(...o.position_m);
      mesh.quaternion.set(x, y, z, w);
    }
    const d = o.distance_m;
    item.state = d === null ? "unknown" : d <= 0 ? "touch" : d - o.growth_m <= this.clearance ? "near" : "";
    const colour = { unknown: "quiet", touch: "bad", near: "warn", "": "obstacle" }[item.state];
    item.body.material.color.set(styled(colour));
    item.shell.material.color.set(styled(item.state === "" || item.state === "unknown" ? "obstacle" : colour));
    item.body.material.opacity = o.kind === "half-space" ? 0.25 : item.state === "unknown" ? 0.3 : 0.8;
    item.distance = d ?? Infinity;
    const title = this.crowd ? `${o.id} of source ${o.source}` : `obstacle ${o.id}`;
    const grown = o.growth_m >= 0.0005 ? `, grown by ${(1000 * o.growth_m).toFixed(0)} mm` : "";
    item.text = d === null ? `${title} not taken over` : `${title} · ${(1000 * d).toFixed(0)} mm${grown}`;
  }

  /** Puts the labels where the camera sees the obstacles. */
  label(camera, width, height) {
    const items = [...this.known.values()].sort((a, b) => a.distance - b.distance);
    const point = new THREE.Vector3();
    const scale = height / (2 * Math.tan((Math.PI / 360) * camera.fov));
    items.forEach((item, i) => {
      const away = camera.position.distanceTo(item.body.position);
      // Above it, where it is not as large as the picture.
      const above = Math.min(0.3 * height, (item.radius * scale) / away + 11);
      point.copy(item.body.position).project(camera);
      const visible = i < LABELS && Math.abs(point.x) < 1 && Math.abs(point.y) < 1 && point.z < 1;
      if (!visible) return item.label.remove();
      item.label.className = item.state;
      if (item.label.textContent !== item.text) item.label.textContent = item.text;
      item.label.style.left = `${((point.x + 1) / 2) * width}px`;
      item.label.style.top = `${((1 - point.y) / 2) * height - above}px`;
      if (!item.label.isConnected) this.labels.append(item.label);
    });
  }
}
