// Part of the friction limit in use, with its interval: a bar from 0 to 100 %, whatever the load.

import { colour, fit } from "./theme.js";

export function drawBar(canvas, grip) {
  const { context: c, width, height } = fit(canvas);
  const x = (share) => 1 + (width - 2) * Math.max(0, Math.min(1, share));
  const shown = JSON.stringify([canvas.width, colour("ink"), grip && [grip.utilisation_low, grip.utilisation, grip.utilisation_high].map((share) => Math.round(x(share)))]);
  if (canvas.dataset.shown === shown) return; // to a pixel: painting costs more than all else
  canvas.dataset.shown = shown;
  c.clearRect(0, 0, width, height);
  c.fillStyle = colour("grid"); c.fillRect(1, 4, width - 2, height - 8);
  if (grip !== null) {
    c.fillStyle = colour("use-band"); c.fillRect(x(grip.utilisation_low), 4, x(grip.utilisation_high) - x(grip.utilisation_low), height - 8);
    c.fillStyle = colour("ink"); c.fillRect(x(grip.utilisation) - 2, 0, 4, height);
  }
  c.strokeStyle = colour("slip"); c.lineWidth = 2; c.beginPath(); c.moveTo(x(1), 0); c.lineTo(x(1), height); c.stroke();
}
