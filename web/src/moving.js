// Moves the camera: around a point, or as on a walk.

import { Quaternion, Vector3 } from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';

const TURN = 0.0035; // radians for each pixel of dragging
const KEY_TURN = 1.2; // radians a second
const STEEPEST = 1.55; // radians from the horizon

const WALK_KEYS = {
    KeyW: 'forward', ArrowUp: 'forward', KeyS: 'back', ArrowDown: 'back', KeyA: 'left', KeyD: 'right',
    ArrowLeft: 'turnLeft', ArrowRight: 'turnRight', KeyR: 'up', PageUp: 'up', KeyF: 'down', PageDown: 'down',
};

export class Moving {
    // `up` is upwards, `speed` what a second of walking covers, `moved` is called after every change.
    constructor(camera, canvas, up, moved) {
        this.camera = camera;
        this.canvas = canvas;
        this.up = new Vector3(...up).normalize();
        this.speed = 0.35;
        this.moved = moved;
        this.held = new Map();
        this.mode = 'orbit';
        this.target = new Vector3();
        this.toY = new Quaternion().setFromUnitVectors(this.up, new Vector3(0, 1, 0));
        this.fromY = this.toY.clone().invert();
        canvas.addEventListener('keydown', (event) => this.key(event, true));
        canvas.addEventListener('keyup', (event) => this.key(event, false));
        canvas.addEventListener('blur', () => this.held.clear());
        canvas.addEventListener('pointerdown', (event) => this.press(event));
        canvas.addEventListener('pointermove', (event) => this.drag(event));
        ['pointerup', 'pointercancel'].forEach((name) =>
            canvas.addEventListener(name, (event) => this.pointers.delete(event.pointerId)));
        canvas.addEventListener('wheel', (event) => this.wheel(event), { passive: false });
        this.pointers = new Map();
    }

    // Puts the camera at a place.
    place(eye, target, mode = this.mode) {
        this.camera.position.set(...eye);
        this.camera.up.copy(this.up);
        this.target.set(...target);
        this.camera.lookAt(this.target);
        this.setMode(mode);
    }

    setMode(mode) {
        this.mode = mode;
        this.held.clear();
        this.orbit?.dispose();
        this.orbit = null;
        if (mode === 'orbit') {
            this.camera.up.copy(this.up);
            this.orbit = new OrbitControls(this.camera, this.canvas);
            this.orbit.target.copy(this.target);
            this.orbit.minDistance = 1e-3;
            this.orbit.maxDistance = 50;
            this.orbit.update();
            this.orbit.addEventListener('change', () => {
                this.target.copy(this.orbit.target);
                this.moved();
            });
        }
        this.moved();
    }

    // The point in the middle of the view: what the camera turns around.
    lookAt() {
        if (this.mode === 'walk') {
            const distance = Math.max(0.1, this.camera.position.distanceTo(this.target));
            this.target.copy(this.camera.position).addScaledVector(this.forward(), distance);
        }
        return this.target.toArray();
    }

    forward() {
        return this.camera.getWorldDirection(new Vector3());
    }

    key(event, down) {
        if (event.ctrlKey || event.metaKey || event.altKey) {
            return;
        }
        const action = WALK_KEYS[event.code];
        const zoom = { Equal: 'in', NumpadAdd: 'in', Minus: 'out', NumpadSubtract: 'out' }[event.code];
        if (!action && !zoom) {
            return;
        }
        event.preventDefault();
        if (down) {
            this.hold(action ?? zoom, event.shiftKey);
        } else {
            this.held.delete(action ?? zoom);
        }
    }

    // Begins an action that goes on until it is released.
    hold(action, fast = false) {
        this.held.set(action, fast);
        this.moved();
    }

    release(action) {
        this.held.delete(action);
    }

    // Goes on with what is held for some seconds. Whether anything moves.
    advance(seconds) {
        for (const [action, fast] of this.held) {
            this.act(action, seconds * (fast ? 3 : 1));
        }
        return this.held.size > 0;
    }

    act(action, seconds) {
        if (this.mode === 'orbit') {
            const angle = KEY_TURN * seconds;
            const turns = {
                left: [-angle, 0], turnLeft: [-angle, 0], right: [angle, 0], turnRight: [angle, 0],
                forward: [0, angle], back: [0, -angle], up: [0, angle], down: [0, -angle],
            };
            if (turns[action]) {
                this.revolve(...turns[action]);
            } else {
                this.zoom(2 ** (action === 'in' ? -seconds : seconds));
            }
            return;
        }
        const step = this.speed * seconds;
        const forward = this.forward();
        const right = forward.clone().cross(this.up).normalize();
        // Steps are level, however steep the view.
        const level = this.up.clone().cross(right);
        const moves = {
            forward: [level, step], back: [level, -step], left: [right, -step], right: [right, step],
            up: [this.up, step], down: [this.up, -step], in: [forward, step], out: [forward, -step],
        };
        if (moves[action]) {
            this.camera.position.addScaledVector(...moves[action]);
        } else {
            this.turn((action === 'turnLeft' ? 1 : -1) * KEY_TURN * seconds, 0);
        }
    }

    // Moves around the target by angles to the right and upwards.
    revolve(right, upwards) {
        const offset = this.camera.position.clone().sub(this.target).applyQuaternion(this.toY);
        const distance = offset.length();
        const around = Math.atan2(offset.x, offset.z) + right;
        const height = Math.asin(Math.max(-1, Math.min(1, offset.y / distance))) + upwards;
        const limited = Math.max(-STEEPEST, Math.min(STEEPEST, height));
        offset.set(Math.sin(around) * Math.cos(limited), Math.sin(limited), Math.cos(around) * Math.cos(limited));
        this.camera.position.copy(this.target).addScaledVector(offset.applyQuaternion(this.fromY), distance);
        this.orbit.update();
    }

    zoom(factor) {
        this.camera.position.sub(this.target).multiplyScalar(factor).add(this.target);
        this.orbit.update();
    }

    // Looks to the left and upwards by angles.
    turn(left, upwards) {
        const d = this.forward().applyQuaternion(this.toY);
        const around = Math.atan2(d.x, d.z) + left;
        const height = Math.max(-STEEPEST, Math.min(STEEPEST, Math.asin(Math.max(-1, Math.min(1, d.y))) + upwards));
        d.set(Math.sin(around) * Math.cos(height), Math.sin(height), Math.cos(around) * Math.cos(height));
        this.camera.up.copy(this.up);
        this.camera.lookAt(d.applyQuaternion(this.fromY).add(this.camera.position));
        this.moved();
    }

    press(event) {
        if (this.mode === 'walk') {
            this.canvas.setPointerCapture(event.pointerId);
            this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
        }
    }

    // One finger or the mouse looks around, two fingers walk.
    drag(event) {
        const last = this.pointers.get(event.pointerId);
        if (!last || this.mode !== 'walk') {
            return;
        }
        const [dx, dy] = [event.clientX - last[0], event.clientY - last[1]];
        this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
        if (this.pointers.size === 1) {
            this.turn(TURN * dx, TURN * dy);
        } else {
            this.act('forward', -0.01 * dy);
            this.act('right', -0.01 * dx);
            this.moved();
        }
    }

    wheel(event) {
        if (this.mode === 'walk') {
            event.preventDefault();
            this.act('in', -0.002 * event.deltaY);
            this.moved();
        }
    }
}
