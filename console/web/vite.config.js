import { defineConfig } from "vite";

// No inline scripts nor styles: the console's Content-Security-Policy refuses them.
export default defineConfig({
  build: {
    target: "es2021",
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    chunkSizeWarningLimit: 1000,
  },
});
