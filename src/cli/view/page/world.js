// What is around the arm: camera, light, ground, target, and where tip and target have been.

import * as THREE from "three";
import { OrbitControls } from "./vendor/three/examples/jsm/controls/OrbitControls.js";
import { Arm } from "./arm.js";
import { styled } from "./colours.js";
import { Obstacles } from "./obstacles.js";

/** Points of a trail at most. */
const TRAIL = 1800;

class Trail {
  constructor(name) {
    this.name = name;
    this.points = new Float32Array(3 * TRAIL);
    this.fade = new Float32Array(4 * TRAIL);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(this.points, 3));
    geometry.setAttribute("color", new THREE.BufferAttribute(this.fade, 4));
    this.line = new THREE.Line(geometry, new THREE.LineBasicMaterial({ vertexColors: true, transparent: true, depthWrite: false }));
    this.line.frustumCulled = false;
  }

  /** The places (each three numbers, or null) of the frames up to the one that is shown. */
  show(places) {
    const colour = new THREE.Color(styled(this.name));
    const used = places.slice(-TRAIL).filter((p) => p);
    used.forEach((p, i) => {
      this.points.set(p, 3 * i);
      this.fade.set([colour.r, colour.g, colour.b, 0.05 + 0.75 * ((i + 1) / used.length) ** 2], 4 * i);
    });
    this.line.geometry.setDrawRange(0, used.length);
    for (const name of ["position", "color"]) this.line.geometry.attributes[name].needsUpdate = true;
  }
}

export class World {
  constructor(canvas, labels, scene) {
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.renderer.setPixelRatio(Math.min(2, devicePixelRatio));
    this.space = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(35, 1, 0.01, 100);
    this.arm = new Arm(scene);
    this.obstacles = new Obstacles(labels);
    this.trails = { tip: new Trail("accent"), target: new Trail("target") };
    this.space.add(this.arm.group, this.obstacles.group, this.trails.tip.line, this.trails.target.line);
    this.light();
    this.size = 0;
    this.geometry = scene.geometry;
    this.obstacles.clearance = scene.geometry?.clearance_m ?? 0;
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.paint());
  }

  light() {
    this.sky = new THREE.HemisphereLight(0xffffff, 0x8a8f94, 2.1);
    this.sun = new THREE.DirectionalLight(0xffffff, 2.2);
    this.space.add(this.sky, this.sun, this.sun.target);
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    this.width = width;
    this.height = height;
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / Math.max(1, height);
    this.camera.updateProjectionMatrix();
    this.stale = true;
  }

  /** Once the first record has come: how large all is, and what is up. */
  begin(frame) {
    const g = this.geometry;
    this.size = g ? g.length_m : this.arm.extent(frame);
    this.obstacles.size = this.size;
    const gravity = new THREE.Vector3(...(g?.gravity_mps2 ?? [0, 0, -1]));
    this.up = gravity.lengthSq() > 0 ? gravity.normalize().negate() : new THREE.Vector3(0, 0, 1);
    this.root = new THREE.Vector3(...(g?.base_position_m ?? frame.nodes.slice(0, 3)));
    const [w, x, y, z] = g?.base_quaternion ?? frame.nodes.slice(3, 7);
    this.along = new THREE.Vector3(1, 0, 0).applyQuaternion(new THREE.Quaternion(x, y, z, w));
    this.camera.near = this.size / 200;
    this.camera.far = 40 * this.size;
    this.camera.up.copy(this.up);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.enableDamping = true;
    this.controls.dampingFactor = 0.12;
    this.controls.maxDistance = 12 * this.size;
    this.controls.minDistance = this.size / 50;
    this.target = this.makeTarget();
    this.space.add(this.target);
    this.makeGround();
    this.look("free");
    this.paint();
  }

  makeTarget() {
    const group = new THREE.Group();
    const size = 0.05 * this.size;
    this.targetMaterial = new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.9 });
    const ring = new THREE.Mesh(new THREE.TorusGeometry(0.55 * size, 0.045 * size, 10, 48).rotateY(Math.PI / 2), this.targetMaterial);
    const dot = new THREE.Mesh(new THREE.SphereGeometry(0.12 * size, 16, 12), this.targetMaterial);
    const pin = new THREE.Mesh(new THREE.CylinderGeometry(0.03 * size, 0.03 * size, size).rotateZ(Math.PI / 2).translate(size / 2, 0, 0), this.targetMaterial);
    group.add(ring, dot, pin);
    return group;
  }

  /** A grid below the arm, and the axes of the base frame at its base. */
  makeGround() {
    const down = this.along.dot(this.up) < -0.3;
    // 1, 2 or 5 times a power of ten, about a seventh of the arm.
    const rough = this.size / 7;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = power * [5, 2, 1].find((n) => n * power <= rough);
    const count = 2 * Math.ceil((0.85 * this.size) / step);
    this.grid = new THREE.GridHelper(count * step, count);
    this.grid.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), this.up);
    this.grid.position.copy(this.root).addScaledVector(this.up, down ? -1.12 * this.size : -0.05 * this.size);
    this.grid.material.transparent = true;
    this.axes = new THREE.AxesHelper(0.09 * this.size);
    this.axes.setColors(0xd1495b, 0x4c9f70, 0x3f78b5);
    this.axes.position.copy(this.root);
    this.space.add(this.grid, this.axes);
  }

  /** Turns the camera to one of the named directions, with the whole arm in sight. */
  look(view) {
    const middle = this.root.clone().addScaledVector(this.along, 0.52 * this.size);
    const [front, side] = this.across();
    const direction = {
      free: front.clone().addScaledVector(side, 0.75).addScaledVector(this.up, 0.38),
      front,
      side,
      end: this.along.clone().addScaledVector(front, 1e-3),
    }[view].normalize();
    const half = 0.6 * this.size;
    const room = Math.min(1, this.camera.aspect || 1);
    const away = half / Math.tan((Math.PI / 360) * this.camera.fov) / room;
    this.controls.target.copy(middle);
    this.camera.position.copy(middle).addScaledVector(direction, away * 1.06);
    this.sun.target.position.copy(middle);
    this.stale = true;
  }

  /** Two level directions: against y and along x of the base frame, where the arm hangs or stands. */
  across() {
    const level = (v) => v.addScaledVector(this.up, -v.dot(this.up));
    let front = level(new THREE.Vector3(0, -1, 0));
    if (front.lengthSq() < 0.01) front = level(new THREE.Vector3(1, 0, 0));
    front.normalize();
    return [front, new THREE.Vector3().crossVectors(this.up, front).normalize()];
  }

  paint() {
    this.space.background = new THREE.Color(styled("view"));
    this.arm.paint();
    if (!this.grid) return;
    const grid = new THREE.Color(styled("grid"));
    this.grid.geometry.attributes.color.array.forEach((_, i, all) => (all[i] = [grid.r, grid.g, grid.b][i % 3]));
    this.grid.geometry.attributes.color.needsUpdate = true;
    this.targetMaterial.color.set(styled("target"));
    this.stale = true;
  }

  show(frame, before) {
    if (this.size === 0) this.begin(frame);
    this.arm.show(frame);
    this.obstacles.show(frame.obstacles);
    this.target.visible = frame.target !== null;
    if (frame.target) {
      const [w, x, y, z] = frame.target.quaternion;
      this.target.position.set(...frame.target.position_m);
      this.target.quaternion.set(x, y, z, w);
    }
    this.trails.tip.show(before.map((f) => f.tip));
    this.trails.target.show(before.map((f) => f.target?.position_m));
    this.stale = true;
  }

  /** Draws where something has changed. */
  draw() {
    if (!this.controls) {
      if (this.stale) this.renderer.render(this.space, this.camera);
      return (this.stale = false);
    }
    const moved = this.controls.update();
    if (!moved && !this.stale) return;
    this.stale = false;
    this.sun.position.copy(this.camera.position).addScaledVector(this.up, 0.8 * this.size);
    this.renderer.render(this.space, this.camera);
    this.obstacles.label(this.camera, this.width, this.height);
  }
}
