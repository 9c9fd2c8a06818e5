// Pictures of the field from the server.

/** Yields the pictures of a response: width, height, divisor and length as u32 LE, then a PNG. */
async function* pictures(response) {
  const reader = response.body.getReader();
  let held = new Uint8Array();
  for (;;) {
    const head = held.length >= 16 ? new DataView(held.buffer, held.byteOffset, 16) : null;
    const end = head ? 16 + head.getUint32(12, true) : Infinity;
    if (held.length >= end) {
      const bitmap = await createImageBitmap(new Blob([held.slice(16, end)], { type: "image/png" }));
      yield { bitmap, divisor: head.getUint32(8, true) };
      held = held.slice(end);
      continue;
    }
    const { done, value } = await reader.read();
    if (done) return;
    const joined = new Uint8Array(held.length + value.length);
    joined.set(held);
    joined.set(value, held.length);
    held = joined;
  }
}

export const post = (address, body, signal) => fetch(address, { method: "POST", body: JSON.stringify(body), signal });

/** Returns what a response says if it is a refusal. */
export async function refused(response) {
  return response.ok ? null : (await response.text()).trim();
}

/** Asks for pictures of the newest view; at most one first picture is awaited, and a newer view stops the finer ones. */
export class Pictures {
  constructor(show, fail) {
    Object.assign(this, { show, fail, wanted: null, waiting: false, abort: null });
    this.viewer = crypto.getRandomValues(new Uint32Array(1))[0];
  }
  want(view) {
    this.wanted = { ...view, viewer: this.viewer };
    if (!this.waiting) this.next();
  }
  async next() {
    const view = this.wanted;
    if (!view) return;
    this.wanted = null;
    this.waiting = true;
    this.abort?.abort();
    const { signal } = (this.abort = new AbortController());
    const { since, ...body } = view;
    try {
      const response = await post("frames", body, signal);
      const why = await refused(response);
      if (why && response.status !== 409) this.fail(why);
      if (!why) {
        for await (const picture of pictures(response)) {
          if (signal.aborted) break;
          this.show(view, picture);
          this.release(signal);
        }
      }
    } catch (error) {
      if (error.name !== "AbortError") this.fail("The server does not answer any more.");
    }
    this.release(signal);
  }
  /** Wants no picture. */
  stop() {
    this.wanted = null;
    this.abort?.abort();
  }
  /** Lets the next view go once the first picture of this one is there. */
  release(signal) {
    if (this.abort?.signal !== signal) return;
    this.waiting = false;
    if (this.wanted) this.next();
  }
}
