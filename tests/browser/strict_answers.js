// Does the page read only what the server says that it answers? Wraps every answer, so that a member which the OpenAPI
// document does not declare for that call cannot be read. Runs before the page's own scripts.

globalThis.strictAnswers = (openapi) => {
  const EVENTS = { iteration: "TraceRow", state: "Session", error: "Session", view: "ViewStatus" };
  const schemas = openapi.components.schemas;
  const operations = Object.entries(openapi.paths).map(([path, methods]) => {
    return [new RegExp(`^${path.replace(/\{[^}]*\}/g, "[^/]+")}$`), methods];
  });
  const parse = JSON.parse;
  const answered = new Map(); // schemas by the text of an answer
  const wrapped = new WeakMap();

  // What a schema may stand for, without references and alternatives.
  function plain(schema) {
    if (schema.$ref) return plain(schemas[schema.$ref.split("/").at(-1)]);
    const alternatives = schema.anyOf ?? schema.oneOf ?? schema.allOf;
    return alternatives ? alternatives.flatMap(plain) : [schema];
  }

  // The schemas of a member; null where nothing is said of what there is.
  function declared(alternatives, key) {
    const found = [];
    for (const { properties, additionalProperties, items } of alternatives) {
      if (properties && Object.hasOwn(properties, key)) found.push(properties[key]);
      else if (additionalProperties === true || additionalProperties === undefined) {
        if (!properties && !items) return null;
      } else if (additionalProperties) found.push(additionalProperties);
      if (items && /^\d+$/.test(key)) found.push(items);
    }
    return found.flatMap(plain);
  }

  function strict(value, alternatives, where) {
    if (value === null || typeof value !== "object") return value;
    const known = wrapped.get(value);
    if (known) return known;
    const kind = Array.isArray(value) ? "array" : "object";
    const fitting = alternatives.filter(({ type }) => type === undefined || type === kind);
    const proxy = new Proxy(value, {
      get(target, key, receiver) {
        const member = Reflect.get(target, key, receiver);
        // what every object and array has, and what promises and JSON ask any value for
        if (
          typeof key === "symbol" ||
          key === "then" ||
          key === "toJSON" ||
          (key in target && !Object.hasOwn(target, key))
        )
          return member;
        if (kind === "array" && key === "length") return member;
        const inner = declared(fitting, key);
        if (inner === null) return member;
        if (!inner.length) {
          const sentence = `${where} is not said to have a member '${key}', which the page reads`;
          console.error(sentence);
          throw new Error(sentence);
        }
        return strict(member, inner, `${where}.${key}`);
      },
    });
    wrapped.set(value, proxy);
    return proxy;
  }

  function schemaOf(method, url, status) {
    const path = new URL(url, location.href).pathname;
    const methods = operations.find(([pattern]) => pattern.test(path))?.[1];
    const answer = methods?.[method.toLowerCase()]?.responses[status];
    return answer?.content?.["application/json"]?.schema ?? answer?.content?.["application/problem+json"]?.schema;
  }

  JSON.parse = (text, reviver) => {
    const value = parse(text, reviver);
    const told = answered.get(text);
    return told ? strict(value, plain(told.schema), told.where) : value;
  };

  const fetch = window.fetch;
  window.fetch = async (path, options = {}) => {
    const response = await fetch(path, options);
    const schema = schemaOf(options.method ?? "GET", path, response.status);
    const text = response.text.bind(response);
    response.text = async () => {
      const body = await text();
      if (schema) answered.set(body, { schema, where: `the answer to ${options.method ?? "GET"} ${path}` });
      return body;
    };
    return response;
  };

  const listen = EventSource.prototype.addEventListener;
  EventSource.prototype.addEventListener = function (kind, listener) {
    listen.call(this, kind, (event) => {
      const schema = EVENTS[kind] && schemas[EVENTS[kind]];
      if (schema) answered.set(event.data, { schema, where: `the event ${kind}` });
      listener(event);
    });
  };

  const open = XMLHttpRequest.prototype.open;
  XMLHttpRequest.prototype.open = function (method, path, ...rest) {
    this.asked = [method, path];
    open.call(this, method, path, ...rest);
  };
  const body = Object.getOwnPropertyDescriptor(XMLHttpRequest.prototype, "response").get;
  Object.defineProperty(XMLHttpRequest.prototype, "response", {
    get() {
      const value = body.call(this);
      const schema = this.asked && this.responseType === "json" && schemaOf(...this.asked, this.status);
      return schema ? strict(value, plain(schema), `the answer to ${this.asked.join(" ")}`) : value;
    },
  });
};
