// What does a 3D view that nobody has named go by? 16 hexadecimal digits, by which no two meet.

export const randomId = () =>
  crypto.getRandomValues(new Uint32Array(2)).reduce((text, value) => text + value.toString(16).padStart(8, "0"), "");
