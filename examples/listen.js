// Prints slips as they are told, and when not to trust the sense of touch; listen_node.c is the addon.
//
//     node listen.js ipc:///run/tactiled/all/events.ipc
const { listen } = require("./listen.node");

listen(process.argv[2], (state, words) => {
  console.log(state === "stale" ? `hold without touch: ${words}` : `${state} of a slip, ${words}`);
});
