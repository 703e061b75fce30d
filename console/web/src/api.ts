// The server, through the console: gRPC-Web with the types of the .proto files.
import { Code, ConnectError, createClient, type Interceptor } from "@connectrpc/connect";
import { createGrpcWebTransport } from "@connectrpc/connect-web";
import { AnswerService } from "./gen/horopter/v1/answers_pb";
import { CatalogService } from "./gen/horopter/v1/catalog_pb";
import { RecognitionService } from "./gen/horopter/v1/recognition_pb";
import { ServerService } from "./gen/horopter/v1/server_pb";
import { StationService } from "./gen/horopter/v1/station_pb";
import { text } from "./strings";

const MARK = { "x-horopter-console": "1" };

export interface Session {
  signed_in: boolean;
  with_token: boolean;
  version: string;
  max_body_bytes: number;
}

// Fired on window when a call says that nobody is signed in (any more).
export const SIGNED_OUT = "horopter-signed-out";

const marked: Interceptor = (next) => async (request) => {
  request.header.set("x-horopter-console", "1");
  try {
    return await next(request);
  } catch (error) {
    if (ConnectError.from(error).code === Code.Unauthenticated) window.dispatchEvent(new Event(SIGNED_OUT));
    throw error;
  }
};

const transport = createGrpcWebTransport({ baseUrl: location.origin, interceptors: [marked] });
export const catalog = createClient(CatalogService, transport);
export const recognition = createClient(RecognitionService, transport);
export const stations = createClient(StationService, transport);
export const answers = createClient(AnswerService, transport);
export const server = createClient(ServerService, transport);

export async function readSession(): Promise<Session> {
  const answer = await fetch("/session");
  if (!answer.ok) throw new Error(answer.statusText);
  return answer.json();
}

// What went wrong, in words; empty: signed in.
export async function signIn(token: string): Promise<string> {
  const answer = await fetch("/sign-in", { method: "POST", headers: MARK, body: JSON.stringify({ token }) });
  if (answer.ok) return "";
  const said = await answer.text();
  try {
    return JSON.parse(said).error;
  } catch {
    return said || answer.statusText;
  }
}

export async function signOut() {
  await fetch("/sign-out", { method: "POST", headers: MARK, body: "" });
}

export function isCode(error: unknown, code: Code) {
  return ConnectError.from(error).code === code;
}

// For people.
export function said(error: unknown): string {
  const failed = ConnectError.from(error);
  if (failed.code === Code.Unavailable) return text.offline;
  if (failed.rawMessage === "Failed to fetch" || /NetworkError|Load failed/.test(failed.rawMessage)) return text.consoleGone;
  return failed.rawMessage || Code[failed.code];
}

export const idOf = (name: string) => name.replace(/^objects\//, "");
export { Code };
