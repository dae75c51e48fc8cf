// Which sessions has this browser had open? One that it has not is played when its card is pressed.

const KEY = "sessions seen";
const MOST = 500; // the oldest are forgotten

const kept = () => {
  try {
    return JSON.parse(localStorage.getItem(KEY)) ?? [];
  } catch {
    return []; // no storage here, or not ours
  }
};

export const wasSeen = (id) => kept().includes(id);

export function see(id) {
  const others = kept().filter((one) => one !== id);
  try {
    localStorage.setItem(KEY, JSON.stringify([...others, id].slice(-MOST)));
  } catch {
    // a browser that keeps nothing plays it again
  }
}
