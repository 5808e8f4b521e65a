import { defineConfig } from "vite";

export default defineConfig({
  base: "./", // the page is served from any port
  worker: { format: "es", rollupOptions: { output: { entryFileNames: "assets/worker.js" } } },
  build: {
    outDir: "../src/palpate/app/view/page",
    emptyOutDir: true,
    sourcemap: false,
    target: "es2022",
    modulePreload: { polyfill: false },
    assetsInlineLimit: 0, // the content security policy allows no inlined scripts
    chunkSizeWarningLimit: 1200,
    rollupOptions: {
      output: {
        entryFileNames: "assets/page.js",
        chunkFileNames: "assets/[name].js",
        assetFileNames: "assets/page[extname]",
      },
    },
  },
});
