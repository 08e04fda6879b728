// What steering says to a character: velocities and targets, with frames that can still change.

export const WALK_MPS = 1.2;
export const RUN_MPS = 3.0;
const SETTLE_S = 0.6; // to begin to walk, and to come to rest
const USUAL_LEAD_FRAMES = 12; // from an edit to the first frame that shows it, where none has shown it yet
const COMMIT_MARGIN_FRAMES = 8; // what is committed while a message is under way

/** The frame `seconds` from now, or the first that a target may surely name. */
export function frameIn(member, seconds) {
  const { track, rig } = member;
  const wanted = Math.round(track.playhead() + seconds * rig.frameRate);
  return Math.max(wanted, track.committedTo + COMMIT_MARGIN_FRAMES, 0);
}

/** The frames that pass before an edit of now shows: those of the last one that was taken. */
export function leadFrames(member) {
  const last = member.info.edits.find((edit) => edit.op !== "set_prompt" && edit.effective_frame !== null);
  return Math.max(last ? last.effective_frame - last.at_frame : 0, USUAL_LEAD_FRAMES);
}

/** Where the root of a member is planned to be at a frame, as far as that is known: {x, z, y}. */
export function rootAt(member, frame) {
  const { track, rig } = member;
  const row = track.row(Math.min(Math.max(frame, track.first), track.end - 1));
  if (!row) return null;
  const at = rig.columns.root_translation_m[0];
  return { x: row[at], y: row[at + 1], z: row[at + 2] };
}

/** Walk to a place and be there when a walk of that length takes. Returns the constraint. */
export function waypointTo(member, place, mps = WALK_MPS) {
  const root = rootAt(member, Math.floor(member.track.playhead())) ?? { x: 0, z: 0 };
  const distance = Math.hypot(place.x - root.x, place.z - root.z);
  const seconds = leadFrames(member) / member.rig.frameRate + distance / mps + SETTLE_S;
  return { kind: "waypoint", frame: frameIn(member, seconds), x_m: place.x, z_m: place.z };
}

/** Follow a drawn line at a pace. points: [[x, z]]; every frame gets a place. mostFrames: of one trajectory. */
export function trajectoryAlong(member, points, mps = WALK_MPS, mostFrames = 400) {
  const rate = member.rig.frameRate;
  const first = frameIn(member, leadFrames(member) / rate);
  const from = rootAt(member, first);
  const line = smoothed(from ? [[from.x, from.z], ...points] : points);
  const lengths = [0];
  for (let n = 1; n < line.length; n++) {
    lengths.push(lengths[n - 1] + Math.hypot(line[n][0] - line[n - 1][0], line[n][1] - line[n - 1][1]));
  }
  const total = lengths[lengths.length - 1];
  const count = Math.min(Math.max(Math.ceil((total / mps) * rate), 2), mostFrames);
  const positions = [];
  let segment = 1;
  for (let n = 1; n <= count; n++) {
    const wanted = Math.min((n * mps) / rate, total);
    while (segment < line.length - 1 && lengths[segment] < wanted) segment++;
    const span = lengths[segment] - lengths[segment - 1] || 1;
    const share = Math.min((wanted - lengths[segment - 1]) / span, 1);
    positions.push([0, 1].map((axis) => line[segment - 1][axis] + share * (line[segment][axis] - line[segment - 1][axis])));
  }
  return { kind: "trajectory", first_frame: first, positions_m: positions };
}

/** A hand's line without its tremble: Chaikin's corner cutting, twice (Chaikin 1974); the ends stay. */
export function smoothed(points) {
  let line = points.filter((p, n) => n === 0 || Math.hypot(p[0] - points[n - 1][0], p[1] - points[n - 1][1]) > 0.02);
  for (let round = 0; round < 2 && line.length > 2; round++) {
    const cut = [line[0]];
    for (let n = 0; n < line.length - 1; n++) {
      const [a, b] = [line[n], line[n + 1]];
      cut.push([0.75 * a[0] + 0.25 * b[0], 0.75 * a[1] + 0.25 * b[1]]);
      cut.push([0.25 * a[0] + 0.75 * b[0], 0.25 * a[1] + 0.75 * b[1]]);
    }
    cut.push(line[line.length - 1]);
    line = cut;
  }
  return line;
}
