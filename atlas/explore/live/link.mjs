// The link to the server: requests with their answers, and what the server tells by itself, as JSON and binary cells.

const AGAIN = 1000; // milliseconds after which a lost link is opened again

/** Open a link, again whenever it is lost, and return a function that sends a request with further fields and promises
 * its answer; a refusal rejects with `isRefusal`. `hear` is called with what the server tells: { tell, ... }, which is "open" or "lost" for the link itself,
 * and "picture" with `bytes` for cells.
 */
export function linkTo(address, hear) {
  const waiting = new Map();
  let socket = null, count = 0;
  const open = () => {
    socket = Object.assign(new WebSocket(address()), { binaryType: "arraybuffer" });
    socket.onopen = () => hear({ tell: "open" });
    socket.onmessage = ({ data }) => {
      const message = typeof data === "string" ? JSON.parse(data) : { tell: "picture", bytes: new Uint8Array(data) };
      const asked = waiting.get(message.id);
      if (!asked) return message.tell && hear(message);
      waiting.delete(message.id);
      if (message.error) asked.reject(Object.assign(new Error(message.error), { isRefusal: true }));
      else asked.resolve(message);
    };
    socket.onclose = () => {
      for (const { reject } of waiting.values()) reject(new Error("the explorer does not answer"));
      waiting.clear();
      hear({ tell: "lost" });
      setTimeout(open, AGAIN);
    };
  };
  open();
  return (ask, given) => new Promise((resolve, reject) => {
    if (socket.readyState !== WebSocket.OPEN) return reject(new Error("the explorer does not answer"));
    waiting.set(++count, { resolve, reject });
    socket.send(JSON.stringify({ ask, id: count, ...given }));
  });
}
