// The arm: base, backbone, disks, cables coloured by their tension. The frame has the nodes' poses, the scene all else.

import * as THREE from "three";
import { ramp, segmentColour, styled } from "./colours.js";

/** Points of the backbone per element. */
const FINE = 5;
const Y = new THREE.Vector3(0, 1, 0);
const X = new THREE.Vector3(1, 0, 0);

/** Many sticks from one point to another, of one material. */
class Sticks {
  constructor(count, material, sides = 8) {
    this.mesh = new THREE.InstancedMesh(new THREE.CylinderGeometry(1, 1, 1, sides, 1), material, count);
    this.mesh.frustumCulled = false;
    this.matrix = new THREE.Matrix4();
    this.quaternion = new THREE.Quaternion();
    this.middle = new THREE.Vector3();
    this.along = new THREE.Vector3();
    this.scale = new THREE.Vector3();
  }

  set(i, from, to, radius) {
    this.along.subVectors(to, from);
    const length = this.along.length();
    this.quaternion.setFromUnitVectors(Y, this.along.divideScalar(length || 1));
    this.middle.addVectors(from, to).multiplyScalar(0.5);
    this.matrix.compose(this.middle, this.quaternion, this.scale.set(radius, Math.max(length, 1e-9), radius));
    this.mesh.setMatrixAt(i, this.matrix);
  }

  done(count) {
    this.mesh.count = count;
    this.mesh.instanceMatrix.needsUpdate = true;
    if (this.mesh.instanceColor) this.mesh.instanceColor.needsUpdate = true;
  }
}

/** Position and orientation of the base and of all nodes of a frame. */
function poses(geometry, nodes) {
  const list = [];
  if (geometry) {
    const [w, x, y, z] = geometry.base_quaternion;
    list.push({ p: new THREE.Vector3(...geometry.base_position_m), q: new THREE.Quaternion(x, y, z, w), node: 0 });
  }
  for (let i = 0; i + 6 < nodes.length; i += 7) {
    const [px, py, pz, w, x, y, z] = nodes.slice(i, i + 7);
    list.push({ p: new THREE.Vector3(px, py, pz), q: new THREE.Quaternion(x, y, z, w) });
  }
  return list;
}

export class Arm {
  constructor(scene) {
    this.geometry = scene.geometry;
    this.group = new THREE.Group();
    this.tip = new THREE.Vector3();
    this.disks = null;
  }

  /** Whether the scene's geometry is that of the records. */
  fits(frame) {
    const g = this.geometry;
    if (!g) return false;
    const nodes = frame.nodes.length / 7;
    return Math.ceil(g.disks.length / frame.stride) === nodes && g.cables.length === frame.command_n.length;
  }

  build(frame) {
    this.group.clear();
    const g = this.fits(frame) ? this.geometry : null;
    this.known = g;
    const nodes = frame.nodes.length / 7;
    this.counted = nodes;
    const size = g ? g.length_m : this.extent(frame);
    this.radius = g ? Math.max(...g.disks.map((d) => d.radius_m)) : 0.03 * size;
    const solid = (colour, more) => new THREE.MeshStandardMaterial({ color: colour, roughness: 0.55, metalness: 0.1, ...more });
    this.materials = { disk: solid(0xffffff), bone: solid(styled("bone")), cable: solid(0xffffff, { roughness: 0.4 }) };
    const round = new THREE.CylinderGeometry(1, 1, 1, 40, 1).rotateZ(-Math.PI / 2);
    this.disks = new THREE.InstancedMesh(round, this.materials.disk, nodes);
    this.disks.frustumCulled = false;
    this.bone = new Sticks((nodes + 1) * (FINE + 1), this.materials.bone, 12);
    const legs = g ? g.cables.reduce((sum, cable) => sum + 2 * cable.holes_m.length, 0) : 0;
    this.cables = new Sticks(Math.max(1, legs), this.materials.cable, 6);
    for (let i = 0; i < legs; i++) this.cables.mesh.setColorAt(i, new THREE.Color(1, 1, 1));
    this.group.add(this.disks, this.bone.mesh, this.cables.mesh);
    if (g) this.group.add(this.base(g));
    this.paint();
  }

  extent(frame) {
    let sum = 0;
    for (let i = 7; i + 2 < frame.nodes.length; i += 7) {
      sum += Math.hypot(...[0, 1, 2].map((k) => frame.nodes[i + k] - frame.nodes[i + k - 7]));
    }
    return sum || 1;
  }

  base(g) {
    const [w, x, y, z] = g.base_quaternion;
    const thick = 0.35 * this.radius;
    const shape = new THREE.CylinderGeometry(1.7 * this.radius, 1.7 * this.radius, thick, 48).rotateZ(-Math.PI / 2);
    const plate = new THREE.Mesh(shape.translate(-0.5 * thick, 0, 0), this.materials.bone);
    plate.quaternion.set(x, y, z, w);
    plate.position.set(...g.base_position_m);
    return plate;
  }

  /** Colours of the theme. */
  paint() {
    if (!this.disks) return;
    this.materials.bone.color.set(styled("bone"));
    const plain = new THREE.Color(styled("disk"));
    for (let k = 0; k < this.counted; k++) {
      const disk = this.known?.disks[this.number(k) - 1];
      const last = disk && this.known.disks[this.number(k)]?.segment !== disk.segment;
      const colour = disk ? plain.clone().lerp(new THREE.Color(segmentColour(disk.segment)), last ? 0.85 : 0.28) : plain;
      this.disks.setColorAt(k, colour);
    }
    this.disks.instanceColor.needsUpdate = true;
  }

  /** The arm's node (1 is the first behind the base) of the k-th of a frame. */
  number(k) {
    return Math.min((k + 1) * (this.stride ?? 1), this.known ? this.known.disks.length : Infinity);
  }

  show(frame) {
    if (!this.disks || this.counted !== frame.nodes.length / 7) {
      this.stride = frame.stride;
      this.build(frame);
    }
    const chain = poses(this.known, frame.nodes);
    const first = this.known ? 1 : 0;
    chain.slice(first).forEach((pose, k) => (pose.node = this.number(k)));
    this.showDisks(chain.slice(first));
    this.showBone(chain);
    if (this.known) this.showCables(chain, frame);
    this.tip.copy(chain.at(-1).p);
  }

  showDisks(chain) {
    const matrix = new THREE.Matrix4();
    const scale = new THREE.Vector3();
    chain.forEach((pose, k) => {
      const disk = this.known?.disks[pose.node - 1];
      const radius = disk ? disk.radius_m : this.radius;
      matrix.compose(pose.p, pose.q, scale.set(Math.max(disk ? disk.thickness_m : 0, 0.06 * radius), radius, radius));
      this.disks.setMatrixAt(k, matrix);
    });
    this.disks.instanceMatrix.needsUpdate = true;
  }

  /** Cubic Hermite from node to node by the tangents, behind the rigid connectors: the curve that distances are taken from. */
  showBone(chain) {
    let n = 0;
    const from = new THREE.Vector3();
    const to = new THREE.Vector3();
    for (let i = 0; i + 1 < chain.length; i++) {
      const [a, b] = [chain[i], chain[i + 1]];
      const element = this.known?.elements[a.node];
      const thick = element ? Math.max(element.backbone_radius_m, 0.07 * this.radius) : 0.15 * this.radius;
      const [ta, tb] = [X.clone().applyQuaternion(a.q), X.clone().applyQuaternion(b.q)];
      const start = a.p.clone();
      const rigid = this.stride === 1 && element ? element.connector_m : 0;
      if (rigid > 0) {
        start.addScaledVector(ta, rigid);
        this.bone.set(n++, a.p, start, 1.6 * thick);
      }
      const length = this.stride === 1 && element ? element.length_m : start.distanceTo(b.p);
      from.copy(start);
      for (let k = 1; k <= FINE; k++) {
        const s = k / FINE;
        const [h10, h01, h11] = [s * (1 - s) ** 2, s * s * (3 - 2 * s), -s * s * (1 - s)];
        to.copy(start).multiplyScalar(1 - h01).addScaledVector(b.p, h01);
        to.addScaledVector(ta, length * h10).addScaledVector(tb, length * h11);
        this.bone.set(n++, from, to, thick);
        from.copy(to);
      }
    }
    this.bone.done(n);
  }

  showCables(chain, frame) {
    const thin = 0.045 * this.radius;
    const colour = new THREE.Color();
    let n = 0;
    this.known.cables.forEach((cable, c) => {
      const measured = frame.measured_n[c];
      const [low, high] = cable.tension_n;
      colour.setRGB(...ramp(((measured ?? frame.command_n[c]) - low) / (high - low)), THREE.SRGBColorSpace);
      let before = null;
      for (const pose of chain) {
        const hole = cable.holes_m[pose.node - cable.from];
        if (!hole) continue;
        const at = (x) => new THREE.Vector3(x, ...hole).applyQuaternion(pose.q).add(pose.p);
        const here = at(0);
        if (before) {
          this.cables.mesh.setColorAt(n, colour);
          this.cables.set(n++, before, here, thin);
        }
        before = here;
        const rigid = this.stride === 1 ? (this.known.elements[pose.node]?.connector_m ?? 0) : 0;
        if (rigid > 0 && cable.holes_m[pose.node - cable.from + 1]) {
          before = at(rigid);
          this.cables.mesh.setColorAt(n, colour);
          this.cables.set(n++, here, before, thin);
        }
      }
    });
    this.cables.done(n);
  }
}
