// Calibrations as ROS's camera_calibration writes them (YAML), and this page's own JSON.
import { create, fromJson } from "@bufbuild/protobuf";
import { CameraCalibrationSchema, type CameraCalibration } from "./gen/horopter/v1/station_pb";
import { text } from "./strings";

const t = text.stations;

// `data: [a, b, ..]` below a key, over line ends; the plain subset of YAML that ROS writes.
function numbersOf(yaml: string, key: string): number[] {
  const found = yaml.match(new RegExp(`^${key}:\\s*(?:#.*)?\\r?\\n(?:[ \\t]+.*\\r?\\n)*?[ \\t]+data:\\s*\\[([^\\]]*)\\]`, "m"));
  return found ? found[1].split(",").map((word) => Number(word.trim())) : [];
}

function wordOf(yaml: string, key: string): string {
  return yaml.match(new RegExp(`^${key}:\\s*["']?([^"'#\\r\\n]*?)["']?\\s*(?:#.*)?$`, "m"))?.[1] ?? "";
}

// Throws with words where it is no calibration; what the server does not take it says itself.
export function parseCalibration(name: string, content: string): CameraCalibration {
  if (!/\.ya?ml$/i.test(name)) return fromJson(CameraCalibrationSchema, JSON.parse(content), { ignoreUnknownFields: true });
  const yaml = content + "\n";
  const k = numbersOf(yaml, "camera_matrix");
  const model = wordOf(yaml, "distortion_model");
  if (k.length !== 9 || k.some((v) => !Number.isFinite(v))) throw new Error(t.noMatrix);
  if (model && model !== "plumb_bob") throw new Error(t.otherLens(model));
  const d = numbersOf(yaml, "distortion_coefficients");
  if (d.some((v) => !Number.isFinite(v))) throw new Error(t.noMatrix);
  return create(CameraCalibrationSchema, { imageWidthPx: Number(wordOf(yaml, "image_width")) || 0, imageHeightPx: Number(wordOf(yaml, "image_height")) || 0, k, d });
}

export function toRosYaml(name: string, c: CameraCalibration): string {
  const d = [...c.d, 0, 0, 0, 0, 0].slice(0, 5);
  const [fx, , cx, , fy, cy] = c.k;
  const matrix = (key: string, rows: number, cols: number, data: number[]) => `${key}:\n  rows: ${rows}\n  cols: ${cols}\n  data: [${data.join(", ")}]\n`;
  return `image_width: ${c.imageWidthPx}\nimage_height: ${c.imageHeightPx}\ncamera_name: ${name}\n${matrix("camera_matrix", 3, 3, c.k)}distortion_model: plumb_bob\n`
    + matrix("distortion_coefficients", 1, 5, d) + matrix("rectification_matrix", 3, 3, [1, 0, 0, 0, 1, 0, 0, 0, 1])
    + matrix("projection_matrix", 3, 4, [fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0]);
}
