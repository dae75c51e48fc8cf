// How does the page talk to the server? By the same REST calls that a program would make, and server-sent events.

// What went wrong, in the server's own sentence; `status` is 0 where no answer came.
export class Problem extends Error {
  constructor(status, sentence) {
    super(sentence);
    this.status = status;
  }
}

export async function call(path, { method = "GET", body, signal } = {}) {
  const headers = { Accept: "application/json" };
  const form = body instanceof FormData; // of which the browser says itself what it is
  if (body !== undefined && !form) headers["Content-Type"] = "application/json";
  let response;
  try {
    response = await fetch(path, {
      method,
      headers,
      signal,
      body: body === undefined || form ? body : JSON.stringify(body),
    });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Problem(0, "The server does not answer.");
  }
  const text = await response.text();
  let answer = null;
  try {
    answer = text ? JSON.parse(text) : null;
  } catch {
    throw new Problem(response.status, `The server answered with ${response.status}, and not with JSON.`);
  }
  if (!response.ok)
    throw new Problem(response.status, answer?.detail ?? `The server answered with ${response.status}.`);
  return answer;
}

export const sessionPath = (id) => `/api/v1/sessions/${encodeURIComponent(id)}`;
export const iterationQuery = (iteration) =>
  iteration === null || iteration === undefined ? "" : `?iteration=${iteration}`;
// To be put behind another; each name by itself, as it may have a comma.
export const linksQuery = (links) => links.map((link) => `&links=${encodeURIComponent(link)}`).join("");

// A page that nobody sees listens for so many milliseconds more: a browser has six connections to a server, for all pages.
const UNSEEN = 3000;

// Server-sent events that come back by themselves. `handlers` maps kinds to functions of the data; `opened` hears of each
// connection, and whether the page rested before it, unseen; `lost` of each break that lasts, `refused` of an end that the
// server means.
export function listen(path, handlers, { opened, lost, refused }) {
  let source = null;
  let rested = false;
  let restTimer = null;
  let breakTimer = null;
  let retryTimer = null;
  let ended = false;
  const open = () => {
    source = new EventSource(path);
    source.onopen = () => {
      clearTimeout(breakTimer);
      breakTimer = null;
      opened?.(rested);
      rested = false;
    };
    for (const [kind, handler] of Object.entries(handlers)) {
      source.addEventListener(kind, (event) => event.data && handler(JSON.parse(event.data)));
    }
    source.onerror = () => {
      // the browser tries again at once; a break shorter than this is nobody's business
      breakTimer ??= setTimeout(() => lost?.(), 1200);
      if (source.readyState === EventSource.CLOSED && !ended) retryTimer = setTimeout(retry, 2000);
    };
  };
  const retry = async () => {
    if (ended) return;
    if (refused && (await refused())) return;
    if (!ended) open();
  };
  const close = () => {
    clearTimeout(breakTimer);
    clearTimeout(retryTimer);
    breakTimer = null;
    source.close();
  };
  const rest = () => {
    rested = true;
    close();
  };
  const seen = () => {
    clearTimeout(restTimer);
    if (document.hidden) restTimer = setTimeout(rest, UNSEEN);
    else if (rested && source.readyState === EventSource.CLOSED) open();
  };
  document.addEventListener("visibilitychange", seen);
  open();
  seen();
  return () => {
    ended = true;
    clearTimeout(restTimer);
    document.removeEventListener("visibilitychange", seen);
    close();
  };
}
