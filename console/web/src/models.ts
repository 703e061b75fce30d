// The parts' geometry, read once: what is drawn over photographs and in scenes.
import { catalog } from "./api";
import { ObjectView, type Object$ as Part } from "./gen/horopter/v1/catalog_pb";

const MOST = 64;
const held = new Map<string, Promise<Part | undefined>>();

// Of `objects/{object}`; undefined where the server does not give it (any more).
export function modelOf(name: string): Promise<Part | undefined> {
  let model = held.get(name);
  if (!model) {
    model = catalog.getObject({ name, view: ObjectView.GEOMETRY }).catch(() => {
      held.delete(name);
      return undefined;
    });
    held.set(name, model);
    if (held.size > MOST) held.delete(held.keys().next().value!);
  }
  return model;
}

export async function modelsOf(names: string[]): Promise<Map<string, Part>> {
  const models = new Map<string, Part>();
  for (const name of new Set(names)) {
    const model = await modelOf(name);
    if (model) models.set(name, model);
  }
  return models;
}

// It was changed.
export function forgetModel(name: string) {
  held.delete(name);
}
