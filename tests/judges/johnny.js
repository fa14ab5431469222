// node johnny.js CONTROLLER RANGE: johnny-five reads one accelerometer over a bus of lines of JSON. It prints each transaction
// as [bytes sent, number of bytes to read], takes the bytes that were read, and prints the reading in g in the end.
const { EventEmitter } = require("events");
const five = require("johnny-five");

const waiting = [];
const lines = require("readline").createInterface({ input: process.stdin });
lines.on("line", (line) => waiting.shift()(JSON.parse(line)));

function ask(out, count, done) {
  waiting.push(done);
  console.log(JSON.stringify([out, count]));
}

class Bus extends EventEmitter {
  constructor() {
    super();
    Object.assign(this, { name: "bus", isReady: true, MODES: {}, pins: [], analogPins: [] });
    process.nextTick(() => ["connect", "ready"].forEach((event) => this.emit(event)));
  }
  i2cConfig() {}
  i2cWrite(address, register, data = []) {
    ask([].concat(register, data), 0, () => {});
  }
  i2cWriteReg(address, register, value) {
    ask([register, value], 0, () => {});
  }
  i2cRead(address, register, count, done) {
    ask([register], count, done);
  }
  i2cReadOnce(address, register, count, done) {
    ask([register], count, done);
  }
}

const board = new five.Board({ io: new Bus(), repl: false, debug: false });
board.on("ready", () => {
  const [controller, range] = process.argv.slice(2);
  const sensor = new five.Accelerometer({ controller, range: Number(range), board });
  sensor.on("data", () => {
    const { x, y, z } = sensor;
    console.log(JSON.stringify({ x, y, z }));
    process.exit(0);
  });
});
