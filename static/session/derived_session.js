// How does another session begin from this one? With the same model, scans and settings, but for what is named.

import { call } from "./api.js";
import { state } from "./state.js";

// Goes to the new session's page; `onError` takes the sentence where it cannot be made.
export async function startDerivedSession(members, suffix, onError) {
  const origin = state.session;
  if (!origin?.model_id) {
    onError(
      "A recording has no model and scans of its own in this server: upload them on the start page to begin anew.",
    );
    return;
  }
  const name = (origin.name || `Session ${origin.id}`).split(" · ")[0];
  const { model_id, scan_ids, method, particles, seed, roi, prior, config, max_std } = origin;
  const body = { model_id, scan_ids, method, particles, seed, roi, prior, config, max_std, ...members };
  body.name = `${name} · ${suffix}`;
  try {
    const session = await call("/api/v1/sessions", { method: "POST", body });
    location.assign(session.view_url);
  } catch (error) {
    onError(error.message);
  }
}
