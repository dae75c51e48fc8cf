// How does another session begin from this one? With the same model, scans and settings, but for what is named.

import { call } from "./api.js";
import { state } from "./state.js";

// Goes to the new session's page; `failed` takes the sentence where it cannot be made.
export async function startAnother(members, what, failed) {
  const old = state.session;
  if (!old?.model_id) {
    failed("A recording has no model and scans of its own in this server: upload them on the start page to begin anew.");
    return;
  }
  const name = (old.name || `Session ${old.id}`).split(" · ")[0];
  const body = {
    model_id: old.model_id, scan_ids: old.scan_ids, method: old.method, particles: old.particles, seed: old.seed,
    roi: old.roi, prior: old.prior, config: old.config ?? {}, max_std: old.max_std, name: `${name} · ${what}`, ...members,
  };
  try {
    const made = await call("/api/v1/sessions", { method: "POST", body });
    location.assign(made.view_url.endsWith("/view/") ? `/sessions/${made.id}/` : made.view_url);
  } catch (error) {
    failed(error.message);
  }
}
