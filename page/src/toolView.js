// Draws the tools of a session, with the arrows of their forces.
import { Vector3 } from "three";

/** Draw the tools of all indices; beyond training they are red, without the arrows of their forces. */
export function showTools(scene, hands, presses, beyond) {
  scene.tools.forEach((mark, index) => {
    mark.group.visible = scene.arrows[index].group.visible = false;
    const slot = hands.slots[index];
    const press = presses.find((each) => each.index === index) ?? null;
    if (slot?.tool) showTool(scene, { ...slot, index, press, former: slot.press, inHand: index === hands.inHand }, beyond);
  });
}

/** Draw a tool: at the driver's pointer for a rigid coupling, otherwise at the pose of the session. */
function showTool(scene, { index, tool, state: now, press, former, inHand }, beyond) {
  const { tools, arrows, size } = scene;
  const there = press !== null || now.kind !== "none";
  const mark = tools[index];
  mark.group.visible = Boolean(there && size);
  if (!there) return;
  const mine = press && (!tool.stiffness || now.kind === "none");
  const [position, quaternion] = mine ? [press.position.toArray(), press.quaternion] : [now.position, now.quaternion];
  mark.shape(tool, size);
  mark.tint(index, beyond);
  mark.at(position, quaternion);
  const blade = press ?? former;
  mark.stroke(blade?.way ?? 1, blade ? Math.max(blade.depth - blade.approach, 0) : 0.35 * (tool.length ?? 0));
  mark.keepInView(scene.camera);
  const ball = tool.kind === "sphere" || tool.kind === "capsule" ? tool.radius : 0;
  if (press && !mine && inHand) showPointer(scene, press, position);
  if (now.kind !== "none" && !beyond) arrows[index].show(position, now.force, now.newtons, size, ball, tool.kind === "grasp" || tool.kind === "group");
}

/** Draw the pose of the pointer where a soft coupling separates it from the tool. */
function showPointer({ ghost, size, camera }, press, position) {
  const { tool } = press;
  const at = press.position;
  ghost.group.visible = tool.kind !== "grasp" && at.distanceTo(new Vector3().fromArray(position)) > 0.004 * size;
  ghost.shape(tool, size);
  ghost.tint(press.index);
  ghost.fade(0.5);
  ghost.stroke(press.way, Math.max(press.depth - press.approach, 0));
  ghost.at(at.toArray(), press.quaternion);
  ghost.keepInView(camera);
}
