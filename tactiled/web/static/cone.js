// Friction cone: the force on the skin against what friction can bear.

import { colour, fit } from "./theme.js";

export function drawCone(canvas, grip, live) {
  const { context: c, width, height } = fit(canvas);
  c.clearRect(0, 0, width, height);
  const ox = 10, oy = height - 10, w = width - 20, h = height - 20;
  c.strokeStyle = colour("line"); c.lineWidth = 1;
  c.beginPath(); c.moveTo(ox, oy - h); c.lineTo(ox, oy); c.lineTo(ox + w, oy); c.stroke();
  c.fillStyle = colour("muted"); c.font = "10px system-ui, sans-serif";
  c.textAlign = "left"; c.fillText("load", ox + 3, oy - h + 8);
  c.textAlign = "right"; c.fillText("shear", ox + w, oy - 4);
  if (grip === null || grip.state === "none") return;
  const shear = Math.hypot(grip.shear_x, grip.shear_y);
  // The middle of the picture is the friction limit at the present load; both axes have one scale of their own.
  const top = Math.max(grip.load, 1e-9) * 1.25;
  const far = Math.max(grip.friction_high * top, shear * 1.1, 1e-9);
  const x = (v) => ox + w * v / far, y = (v) => oy - h * v / top;
  c.beginPath(); c.moveTo(ox, oy); c.lineTo(x(grip.friction_low * top), y(top)); c.lineTo(x(Math.min(far, grip.friction_high * top)), y(top)); c.closePath();
  c.fillStyle = colour("cone-band"); c.fill();
  c.beginPath(); c.moveTo(ox, oy); c.lineTo(x(grip.friction * top), y(top)); c.strokeStyle = colour("slip"); c.lineWidth = 2; c.stroke();
  c.beginPath(); c.moveTo(ox, oy); c.lineTo(x(shear), y(grip.load)); c.strokeStyle = live ? colour("ink") : colour("stale-ink"); c.lineWidth = 2.5; c.stroke();
  c.beginPath(); c.arc(x(shear), y(grip.load), 5, 0, 2 * Math.PI); c.fillStyle = live ? colour("contact") : colour("stale"); c.fill();
}
